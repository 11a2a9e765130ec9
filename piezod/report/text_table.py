"""A table as text for a terminal: columns padded to their widest cell."""

from collections.abc import Sequence


def column_widths(rows: Sequence[Sequence[str]]) -> list[int]:
    """Number of characters of the widest cell of each column.

    Parameters
    ----------
    rows
        Cells of each row, equally many in every row; at least one row.
    """
    return [max(map(len, column)) for column in zip(*rows, strict=True)]


def text_table(rows: Sequence[Sequence[str]], left_aligned: int = 1) -> list[str]:
    """Format rows as lines, with two spaces between columns.

    Parameters
    ----------
    rows
        Cells; the header is the first row. All rows have equal lengths.
    left_aligned
        Number of columns, from the first, that are left-aligned. The others are right-aligned.
    """
    widths = column_widths(rows)
    return [
        "  ".join(
            cell.ljust(width) if column < left_aligned else cell.rjust(width)
            for column, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    ]
