"""`piezod docs`: the manual that is installed with the program."""

import json
import sys
from typing import Annotated

import typer

from piezod.cli.root import JsonOption, app
from piezod.errors import UsageError


@app.command(epilog="Example: piezod docs diagnose --print")
def docs(
    topic: Annotated[str | None, typer.Argument(metavar="[TOPIC]", help="Page to show; default: overview.")] = None,
    is_printed: Annotated[bool, typer.Option("--print", help="Print the page and open no browser.")] = False,
    is_list: Annotated[bool, typer.Option("--list", help="List the topics.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Open a page of the manual in a browser; print it if there is no display or the output is no terminal."""
    from piezod.commissioning.manual import (
        FIRST,
        has_display,
        open_in_browser,
        topic_as_dict,
        topic_named,
        topics,
        topics_table,
    )

    if is_list and topic is not None:
        raise UsageError("--list lists every topic: give no TOPIC")
    chosen = topic_named(topic or FIRST)
    if as_json:
        shown = topics().values() if topic is None else [chosen]
        print(json.dumps({"schema": "piezod.docs/1", "topics": [topic_as_dict(page) for page in shown]}, indent=2))
    elif is_list:
        print(topics_table())
    elif not sys.stdout.isatty():
        print(chosen.text, end="")
    elif is_printed or not has_display() or not open_in_browser(chosen):
        from rich.console import Console
        from rich.markdown import Markdown

        Console().print(Markdown(chosen.text, hyperlinks=False) if chosen.is_markdown else chosen.text, markup=False)
