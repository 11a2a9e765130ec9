"""The recorder process: entry point and main loop.

    python -m piezod.recorder.writer PLAN

The daemon starts it (`recorder/watch.py`); `recorder/messages.py` shows the messages. When the daemon dies, the
process continues until the control process, too, has ended.
"""

import json
import signal
import sys
from collections.abc import Callable
from pathlib import Path

from piezod.recorder.messages import MessageReader, Plan, Report, report_sender
from piezod.recorder.ring_recorder import RingRecorder
from piezod.runtime import clock, signals

QUIET_S = 2.0
"""Without the daemon: time without a new row after which the process ends [s]. The control process has ended then."""
ORPHAN_WITHIN_S = 60.0  # longest life of the process after the daemon has died [s]


def run(
    recorder: RingRecorder, messages: MessageReader, send_report: Callable[[Report], None], interval_s: float
) -> None:
    """Record until the message `end`, SIGTERM, or the end of daemon and control process.

    Parameters
    ----------
    recorder
        Recorder without a ring log.
    send_report
        Called after every step.
    interval_s
        Time between two steps [s].
    """
    ending = False

    def end(*_: object) -> None:
        nonlocal ending
        ending = True

    signals.handle(signal.SIGTERM, end)
    orphaned_s = quiet_s = float("inf")
    row = -1
    while not ending:
        for message in messages.wait(interval_s):
            if "ring" in message:
                recorder.follow(Path(str(message["ring"])), str(message["session"]))
            ending = ending or bool(message.get("end"))
        recorder.step()
        send_report(recorder.report)
        now_s = clock.monotonic()
        if not messages.closed or recorder.report.row != row:
            row, quiet_s = recorder.report.row, now_s
        orphaned_s = min(orphaned_s, now_s) if messages.closed else orphaned_s
        is_quiet = now_s - quiet_s > max(QUIET_S, 2 * interval_s)
        ending = ending or (messages.closed and (is_quiet or now_s - orphaned_s > ORPHAN_WITHIN_S))
    recorder.finish()
    send_report(recorder.report)


def main() -> None:
    """Run the recorder process with the plan in its first argument."""
    for number in (signal.SIGINT, signal.SIGHUP):
        signals.handle(number, signal.SIG_IGN)
    plan = Plan(**json.loads(sys.argv[1]))
    messages, send_report = MessageReader(sys.stdin.fileno()), report_sender(sys.stdout.fileno())
    run(RingRecorder(plan), messages, send_report, plan.sync_every_s)


if __name__ == "__main__":
    main()
