"""The report of an identification: one page to decide from, its plots, JSON and model file."""

from ema_identification.report.write import (
    MODEL_FILE,
    NEXT_TEST_FILE,
    Page,
    write_answer,
    write_page,
    write_report,
)

__all__ = ["MODEL_FILE", "NEXT_TEST_FILE", "Page", "write_answer", "write_page",
           "write_report"]
