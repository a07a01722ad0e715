"""The `ema` command: thin, calls the other packages."""

import gc
import os

gc.set_threshold(100_000)  # importing makes no rubbish: a collection each 700 objects takes 10 %
os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")  # not looked for in all packages
