"""The task of a control process, its outcome, and the segments that it drives.

This module imports little. The control process starts first and loads its own modules while its parent loads others.
"""

import signal
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from piezod.config import BenchConfig

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from piezod.config.reference import ReferenceConfig
    from piezod.control import ControlLoop, RateKeeper
    from piezod.model import Model
    from piezod.transport import Link

URGENT = {"disarm": signal.SIGRTMIN + 1, "stop": signal.SIGRTMIN + 2}
"""Signals that command the control process without the pipe."""


@dataclass(frozen=True)
class SegmentSpec:
    """Description of one segment in plain values, so that it can be sent to another process.

    Parameters
    ----------
    name
        Name of the segment, for messages.
    compensation
        `inverse`, `gain`, or `direct`. With `direct` the voltages are driven as they are.
    reference
        Reference to follow; None: the reference of the bench configuration.
    voltages_V
        Voltages of a direct drive, one per tick, shape (N,) [V].
    reset_cycle
        Whether to drive 0 -> voltage_max_V -> 0 first.
    model
        Model of the compensation; None: the model of the task.
    """

    name: str
    compensation: str
    reference: "ReferenceConfig | None" = None
    voltages_V: "NDArray[np.float64] | None" = None
    reset_cycle: bool = True
    model: "Model | None" = None


class Program(Protocol):
    """Drive of its own in the control process; sent there from another process."""

    def prepare(self, bench: BenchConfig, link: "Link", clock: "RateKeeper") -> "Link":
        """Link that the loop drives through: the opened link of the bench, or one around it."""

    def run(self, loop: "ControlLoop") -> object:
        """Drive until the end, or until `loop.stopped`, and bring the bench to rest; the result goes to the parent."""


@dataclass(frozen=True)
class Task:
    """Input of a control process.

    Parameters
    ----------
    bench, model
        Result of `load_bench_and_model`; no model: None.
    folder
        Folder that relative paths start from.
    segments
        Segments to drive, in this order. Empty: read the bench until stopped.
    serves
        Bench configuration to serve until stopped. The control process loads the model that it names, follows its
        reference after each `arm`, and is disarmed otherwise. None: drive `segments`.
    heat_W
        Mean power of the stack at the end of the control process before [W]: the stack is still warm.
    program
        Drive in place of segments; None: drive `segments`.
    """

    bench: BenchConfig
    model: "Model | None"
    folder: Path
    segments: tuple[SegmentSpec, ...]
    serves: Path | None = None
    heat_W: float = 0.0
    program: Program | None = None


@dataclass(frozen=True)
class SharedMemory:
    """Memory that the control process shares with its parent.

    Parameters
    ----------
    phases
        int64 values of `piezod.control.PhaseTimes`.
    correction
        float64 values of a `RepeatCorrection`; None: no learned correction.
    bad_exchange
        Memory of the last failed exchange (`transport/bad_exchange.py`); None: not kept.
    """

    phases: Any
    correction: Any = None
    bad_exchange: Any = None


@dataclass(frozen=True)
class Ready:
    """Content of the message `ready`.

    Parameters
    ----------
    files
        Digest of model and reference file, read before they were loaded (`session/files.py`); empty: none was loaded.
    """

    description: str
    files: str = ""


@dataclass
class Outcome:
    """Result of a session.

    Parameters
    ----------
    ticks, missed
        Number of ticks that ran, and of ticks that were skipped because an earlier one was late.
    failed_exchanges
        Number of exchanges without a good reading.
    results
        Number of exchanges by result.
    fault
        Text of the latched fault; empty without one.
    stopped
        Whether a stop was requested.
    resident_kib
        Resident memory of the control process at its end [KiB].
    stale_bytes
        Number of received bytes that belonged to no request, or came too late; they were discarded.
    spikes
        Number of force spikes that were ignored.
    hint
        Advice about the link; empty without one.
    heat_W
        Mean power that the stack turned into heat, at the end [W].
    returned
        Result of the program of the task; None without one.
    """

    ticks: int = 0
    missed: int = 0
    failed_exchanges: int = 0
    results: dict[str, int] = field(default_factory=dict)
    fault: str = ""
    stopped: bool = False
    warnings: list[str] = field(default_factory=list)
    resident_kib: int = 0
    stale_bytes: int = 0
    spikes: int = 0
    hint: str = ""
    heat_W: float = 0.0
    returned: Any = field(default=None, init=False)
