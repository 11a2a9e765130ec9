"""The HTML that all pages share: rows of figures, tables, and no external resources."""

import re

import pytest
from bokeh.plotting import figure

from piezod.report.page import axis_label, table_html, write_page


def plot(title):
    made = figure(title=title)
    made.line([0, 1], [0, 1])
    return made


def test_figures_of_one_part_are_side_by_side(tmp_path):
    parts = [[plot("one"), plot("two")], "<p>between</p>", [plot("three")]]
    write_page(tmp_path / "page.html", "page", ("A & B", "so <well>"), parts)
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert page.count("data-root-id=") == 3
    assert "<!--" not in page
    pair = page[page.index("class='pair'") : page.index("<p>between</p>")]
    assert pair.count("<figure>") == 2
    assert "<h1>A &amp; B</h1><p class='lead'>so &lt;well&gt;</p>" in page
    outside = re.sub("(<script[^>]*>).*?</script>", r"\1", page, flags=re.DOTALL)
    assert not {"<link", "@import", "src="} & set(re.findall("<link|@import|src=", outside))


def test_a_page_may_have_no_figures(tmp_path):
    write_page(tmp_path / "page.html", "words", ("words", "alone"), ["<p>words alone</p>"])
    assert "<p>words alone</p>" in (tmp_path / "page.html").read_text(encoding="utf-8")


def test_groups_of_columns_are_above_the_header():
    made = table_html(["reference", "rms", "max"], [["a", "1", "<2>"]], groups=[("", 1), ("with & without", 2)])
    assert "<th class='group' colspan='2'>with &amp; without</th></tr><tr><th>reference</th>" in made
    assert "<td>&lt;2&gt;</td>" in made
    assert "<div class='scroll' role='group' aria-label='table' tabindex='0'>" in made


@pytest.mark.parametrize(
    ("channel", "label"),
    [
        ("voltage_V", "voltage [V]"),
        ("displacement_um", "displacement [\N{MICRO SIGN}m]"),
        ("readback_voltage_V", "readback voltage [V]"),
        ("force", "force"),
    ],
)
def test_an_axis_label_has_quantity_and_unit(channel, label):
    assert axis_label(channel) == label
