"""The deliberate errors of this package.

EmulatorError
    StudyError       a study cannot be made or read
        SealError    the sealed truth is missing or was changed
"""

from firmware_sim.errors import EmulatorError


class StudyError(EmulatorError):
    """One line: what, where, the value, what to do."""


class SealError(StudyError):
    """The sealed truth is missing, or differs from its hash."""
