"""The phases of a test with their names, for pictures."""

from __future__ import annotations

from ema_prognostics.features.profile_kind import profile_kind
from ema_prognostics.words import words
from ema_record.actuator import load_actuator
from ema_record.profile import Profile
from ema_record.profiles.plan import test_plan


def phases_of(profile: Profile) -> list[tuple[float, float, str]]:
    """Return the parts of a test that the diagnosis looks at; empty for a test not known.

    Of each: begin, end (s after the acceptance of the command), name.
    """
    actuator = load_actuator()
    if profile_kind(profile, actuator) is None:
        return []
    say, plan, start = words(), test_plan(profile, actuator), profile.command_time
    found = [(start + part.begin, start + part.end,
              say("phases.full" if name.startswith("full") else "phases.quarter"))
             for name, part in plan.segments.items()]
    found += [(start + begin, start + end, say("phases.ramp"))
              for begin, end in plan.ramps.values()]
    return sorted(found)
