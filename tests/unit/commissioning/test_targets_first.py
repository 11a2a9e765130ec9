"""Commands with `-o` check their target before they read a bench file or reach for a device."""

import pytest

from piezod.commissioning.proof import prove
from piezod.commissioning.support_bundle import write_bundle
from piezod.errors import ConfigurationError, UsageError


@pytest.mark.parametrize("write", [prove, write_bundle])
def test_a_target_that_cannot_be_written_is_refused_before_the_bench_file_is_read(write, tmp_path):
    there = tmp_path / "there"
    there.write_text("kept", encoding="utf-8")
    dangling = tmp_path / "dangling"
    dangling.symlink_to(tmp_path / "nowhere")
    none = tmp_path / "no_bench.yaml"
    for target in (there, dangling):
        with pytest.raises(UsageError, match="already exists"):
            write(none, target)
    with pytest.raises(ConfigurationError, match="folder"):
        write(none, tmp_path / "none" / "file")
    with pytest.raises(ConfigurationError, match="folder"):
        write(none, there / "file")
    assert there.read_text(encoding="utf-8") == "kept"
