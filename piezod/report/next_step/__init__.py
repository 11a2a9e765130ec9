"""The next step after each command, with the lines to paste.

One function for each command. A file that the user does not have yet is in capitals, as in the help: BENCH.yaml.
"""

from piezod.report.next_step.of_benches import (
    after_check,
    after_config_check,
    after_convert,
    after_demo,
    after_discover,
    after_init,
    after_investigate,
    after_latency,
    after_proof,
    after_record,
    after_report,
    after_run,
    after_sequence,
    after_status,
    after_validate,
    from_bench,
)
from piezod.report.next_step.of_models import (
    after_compare,
    after_diagnose,
    after_identify,
    after_resid,
    after_simulate,
    after_testable,
)
from piezod.report.next_step.of_studies import (
    UNFINISHED,
    after_blind_make,
    after_blind_run,
    after_blind_score,
    after_effects,
    after_fleet,
    after_history,
)
from piezod.report.next_step.step import AT_NOISE, RESTING, STRUCTURED, NextStep

__all__ = [
    "AT_NOISE",
    "RESTING",
    "STRUCTURED",
    "UNFINISHED",
    "NextStep",
    "after_blind_make",
    "after_blind_run",
    "after_blind_score",
    "after_check",
    "after_compare",
    "after_config_check",
    "after_convert",
    "after_demo",
    "after_diagnose",
    "after_discover",
    "after_effects",
    "after_fleet",
    "after_history",
    "after_identify",
    "after_init",
    "after_investigate",
    "after_latency",
    "after_proof",
    "after_record",
    "after_report",
    "after_resid",
    "after_run",
    "after_sequence",
    "after_simulate",
    "after_status",
    "after_testable",
    "after_validate",
    "from_bench",
]
