"""The service that all sequences share."""

import contextlib
import time
from collections import Counter
from pathlib import Path

import yaml

from piezod.control import RingReader
from piezod.errors import PiezodError
from tests.faults.live_bench import LiveBench
from tests.faults.probe import Probe
from tests.stateful.judge import RAMP_DOWN_V_PER_S, Judge

RELEASE_WITHIN_S = 10.0  # until a service whose parent was killed has given the device back
BENCH = {
    "limits": {"arming_timeout_s": 2.0, "ramp_down_V_per_s": RAMP_DOWN_V_PER_S},
    "reference": {"kind": "stream", "stale_after_s": 0.2, "when_stale": "ramp_down"},
}


class LiveService:
    """The bench that all sequences share, its judge and the sender of its reference."""

    def __init__(self, folder):
        self.probe = Probe()
        stream = folder / "stream"
        self.bench = LiveBench(folder, None, BENCH | {"reference": BENCH["reference"] | {"listen": str(stream)}})
        self.text = self.bench.path.read_text(encoding="utf-8")
        self.sound_path = folder / "sound.yaml"  # stays as it is, for the paths of the bench
        self.sound_path.write_text(self.text, encoding="utf-8")
        self.text_with_tenth = self._text_with_tenth(folder)
        self.has_foreign_model = False
        self.stream = stream
        self.bench.restore()
        self.judge = Judge(self.bench, self.probe)
        self.done, self.sequences, self.control_killed = Counter(), 0, False
        self.before = []  # steps of the sequence before

    def _text_with_tenth(self, folder):
        """Bench file with a model of a tenth of the gain, which claims to have measured as little."""
        content = yaml.safe_load(self.text)
        model = yaml.safe_load(Path(content["model"]).read_text(encoding="utf-8"))
        zones, output = model["hysteresis"]["dead_zones"], model["output"]
        zones["weights"] = [0.1 * weight for weight in zones["weights"]]
        model["hysteresis"]["offset"] *= 0.1
        output["low"], output["high"] = 0.1 * output["low"], 0.1 * output["high"]
        path = folder / "tenth.yaml"
        path.write_text(yaml.safe_dump(model), encoding="utf-8")
        return yaml.safe_dump(content | {"model": str(path)})

    def anew(self):
        """Restore bench and file; a service that was killed is started again when the device is free.

        A service ends when its control process was killed.
        """
        if self.control_killed:
            self.bench.service.process.wait(timeout=RELEASE_WITHIN_S)
            self.control_killed = False
        if self.has_foreign_model and self.bench.service is not None and self.bench.service.alive:
            self.bench.service.end()
        self.has_foreign_model = False
        self.bench.path.write_text(self.text, encoding="utf-8")
        self.bench.device.ask("idle", closes_after_s=0.0)
        deadline_s = time.monotonic() + RELEASE_WITHIN_S
        while True:
            try:
                self._await_control_process(deadline_s)
                self.bench.restore()
            except AssertionError:
                refused = self.bench.service is None or not self.bench.service.alive
                if not refused or time.monotonic() > deadline_s:
                    raise
                time.sleep(0.1)
            else:
                return

    def _await_control_process(self, deadline_s):
        """Read the ring log of the present control process; an accepted reload has started another."""
        while self.bench.service is not None and self.bench.service.alive and time.monotonic() < deadline_s:
            with contextlib.suppress(PiezodError):
                if self.bench.status()["connected"]:
                    self.bench._ring = RingReader(self.bench.folder / "ring")
                    return
            time.sleep(0.02)

    def close(self):
        self.bench.close()
        self.probe.close()
