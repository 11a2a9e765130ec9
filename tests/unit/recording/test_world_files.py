"""Files of other programs: the numbers that were written, or a line that says what to do. Never other numbers."""

import numpy as np
import pytest

from piezod.errors import PiezodError
from piezod.recording import read_recording
from piezod.recording.formats.repairs import repair_notes
from tests.benches.instrument_files import instrument_files
from tests.benches.world_files import DT_S, F_N, U_V, WorldFile, world_files


@pytest.mark.parametrize("file", [*world_files(), *instrument_files()], ids=lambda file: file.name)
def test_a_file_is_read_right_or_refused_with_what_to_do(tmp_path, file: WorldFile):
    if not file.is_possible:
        pytest.skip(f"{file.needs} is not installed")
    path = file.make(tmp_path)
    if file.refused:
        with pytest.raises(PiezodError, match=file.refused) as caught:
            read_recording(path, file.options)
        assert "\n" not in str(caught.value)
        assert str(caught.value).startswith(str(path))
        return
    recording = read_recording(path, file.options)
    assert recording.time_s.size == file.rows
    np.testing.assert_allclose(np.diff(recording.time_s), DT_S, atol=1e-6)
    voltage_V = U_V if file.wanted_V is None else file.wanted_V
    assert not file.lacks or file.lacks not in recording.channels
    compared = [(file.u, voltage_V, file.factors[0]), (file.f, F_N, file.factors[1])][bool(file.lacks) :]
    for name, expected, factor in compared:
        values = recording.channels[name]
        present = np.isfinite(values)
        np.testing.assert_allclose(values[present], factor * expected[: file.rows][present], atol=factor * file.atol)
        assert np.count_nonzero(~present) <= 5
    said = "; ".join([recording.metadata.get("understood", ""), *repair_notes(recording.metadata)])
    assert file.says in said
    missing = sum(int(np.count_nonzero(~np.isfinite(recording.channels[name]))) for name, _, _ in compared)
    own = file.suffix == ".parquet" or "NaN" in path.read_text(errors="replace")  # the format's own missing value
    assert not missing or "read as missing" in said or own
