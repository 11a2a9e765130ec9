"""Checks of this machine: rights on the files, room for the recorder, clock, real-time rights."""

import os
import resource
import shutil
import stat
import time
import warnings
from collections.abc import Iterator
from pathlib import Path

from piezod.commissioning.check_result import Check
from piezod.config import BenchConfig
from piezod.control import RealTimeWarning, real_time
from piezod.recorder.recording_files import recording_files, size_bytes

CLOCK_SOURCE = Path("/sys/devices/system/clocksource/clocksource0/current_clocksource")
COARSEST_CLOCK_S = 1e-6


def check_machine(bench: BenchConfig) -> Iterator[Check]:
    """Check this machine without a change of it."""
    yield from _recorder(bench)
    yield _clock()
    yield from _real_time_rights(bench)


def check_configuration_file(path: Path) -> Iterator[Check]:
    """Check owner and mode of the configuration: whoever can write it can change the limits."""
    status = path.stat()
    if status.st_mode & stat.S_IWOTH:
        yield Check("configuration", "WARN", f"{path} can be written by everybody", "chmod o-w it")
    if status.st_uid not in (0, os.getuid()):
        yield Check("configuration", "WARN", f"{path} belongs to uid {status.st_uid}", "let root or the service own it")


def _recorder(bench: BenchConfig) -> Iterator[Check]:
    """Check that the recorder can write its folder, and that the disk has room for it."""
    config, folder = bench.recorder, bench.recordings_path
    if config is None or folder is None:
        yield Check("recorder", "OK", "off: ticks are not recorded; set recorder.folder to record them")
        return
    place = folder if folder.exists() else folder.parent
    if not place.is_dir():
        yield Check(
            "recorder", "FAIL", f"recorder.folder is {folder}: {place} is not a folder", "create it, or name another"
        )
    elif not os.access(place, os.W_OK | os.X_OK):
        owner = place.stat()
        finding = f"recorder.folder is {folder}: {place} may not be written by uid {os.getuid()}"
        remedy = f"it belongs to uid {owner.st_uid}, gid {owner.st_gid}, mode {stat.S_IMODE(owner.st_mode):04o}"
        yield Check("recorder", "FAIL", finding, remedy)
    else:
        own_bytes = sum(map(size_bytes, recording_files(place, bench.name)))
        free_MB = 1e-6 * shutil.disk_usage(place).free + 1e-6 * own_bytes
        finding = f"every tick into {folder}, at most {config.folder_MB:g} MB; {free_MB:.0f} MB are available"
        if free_MB < config.folder_MB:
            yield Check("recorder", "WARN", finding, "lower recorder.folder_MB, or free disk space")
        else:
            yield Check("recorder", "OK", finding)


def _clock() -> Check:
    resolution_s = time.get_clock_info("monotonic").resolution
    name = CLOCK_SOURCE.read_text(encoding="ascii").strip() if CLOCK_SOURCE.exists() else "unknown"
    is_fine = resolution_s <= COARSEST_CLOCK_S
    return Check("clock", "OK" if is_fine else "WARN", f"{name}, resolution {resolution_s * 1e9:.0f} ns")


def _real_time_rights(bench: BenchConfig) -> Iterator[Check]:
    """Request the real-time settings of the bench for a moment, and report each refusal of the kernel."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        with real_time(bench.real_time):
            pass
    missing = [str(warning.message) for warning in caught if issubclass(warning.category, RealTimeWarning)]
    for text in missing:
        finding, _, remedy = text.partition("; ")
        yield Check("real-time rights", "WARN", finding, remedy)
    if not missing:
        limit = resource.getrlimit(resource.RLIMIT_RTPRIO)[0]
        yield Check("real-time rights", "OK", f"all requests are granted (uid {os.getuid()}, RTPRIO {limit})")
