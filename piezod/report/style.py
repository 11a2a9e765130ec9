"""Colours, style sheet, script and template that all pages share."""

# Okabe and Ito, "Color Universal Design" (2008): colours that colour-blind readers can distinguish.
BLUE, ORANGE, GREEN, GREY, RED = "#0072B2", "#E69F00", "#009E73", "#999999", "#D55E00"

A4_PIXELS = 1200  # width of the layout of a printed page
A4_ZOOM = 0.58  # scales that width to the 186 mm between the margins

PAGE_CSS = f"""
:root {{ --line: #d9d9d9; --soft: #f5f6f7; --dim: #555; }}
* {{ box-sizing: border-box; }}
body {{ font: 14px/1.4 system-ui, "Segoe UI", Helvetica, Arial, sans-serif; color: #1c1c1c; background: #fff;
  margin: 0 auto; max-width: 1240px; padding: 14px 20px 40px; }}
h1 {{ font-size: 26px; line-height: 1.2; margin: 2px 0 2px; text-wrap: balance; }}
h2 {{ font-size: 19px; margin: 30px 0 4px; padding-top: 10px; border-top: 1px solid var(--line); }}
h3 {{ font-size: 15px; margin: 14px 0 4px; }}
p {{ margin: 4px 0 8px; }} .lead {{ font-size: 15.5px; }} .dim, small {{ color: var(--dim); }}
code {{ font-size: 0.85em; color: var(--dim); font-weight: normal; }}
a {{ color: {BLUE}; }}
.chip {{ display: inline-block; padding: 1px 10px; border-radius: 10px; color: #fff; font-weight: 600; font-size: 13px;
  background: {BLUE}; }}
.chip.matches {{ background: #00775a; }} .chip.partly_explained {{ background: {ORANGE}; color: #000; }}
.chip.unexplained {{ background: #b84e00; }} .chip.not_testable {{ background: #666; }}
.chain {{ list-style: none; display: grid; grid-template-columns: repeat(6, 1fr); gap: 18px; margin: 10px 0 12px;
  padding: 0; }}
.chain li {{ position: relative; border: 1px solid var(--line); border-radius: 6px; padding: 4px 10px;
  background: var(--soft); }}
.chain li + li::before {{ content: "\\2192"; position: absolute; left: -17px; top: 8px; color: {GREY}; }}
.chain span, .chain b, .chain i {{ display: block; }} .chain span {{ color: var(--dim); font-size: 12px; }}
.chain i {{ color: #6b6b6b; font-size: 12px; }} .chain b {{ font-size: 13.5px; line-height: 1.25; }}
.chain li.hit {{ border: 2px solid {RED}; background: #fdf1ea; padding: 3px 9px; }}
.chain li.hit span::after {{ content: " \\25CF"; color: {RED}; }}
.first {{ display: grid; grid-template-columns: minmax(0, 1fr) 390px; gap: 22px; align-items: start; }}
table {{ border-collapse: collapse; width: 100%; font-size: 13px; }}
th, td {{ text-align: left; vertical-align: top; padding: 5px 10px 5px 0; border-bottom: 1px solid var(--line); }}
th {{ color: var(--dim); font-weight: 600; font-size: 12px; }}
td small {{ display: block; font-size: 12px; line-height: 1.3; }}
.effects td:first-child {{ min-width: 140px; }} .effects td:nth-child(3) {{ min-width: 90px; }}
.parameter {{ display: block; margin-bottom: 2px; }} .parameter small {{ display: block; }}
.bar {{ display: block; width: 84px; height: 9px; background: #e4e4e4; border-radius: 5px; overflow: hidden;
  margin: 4px 0 2px; }}
.bar span {{ display: block; height: 100%; background: {BLUE}; }}
.where {{ margin-top: 10px; }} .places {{ max-width: 620px; }}
.files td:last-child {{ font-family: ui-monospace, monospace; font-size: 11px; word-break: break-all; }}
.card table + table {{ margin-top: 10px; }}
.card {{ border: 1px solid var(--line); border-left: 4px solid {RED}; border-radius: 6px; padding: 2px 16px 10px;
  margin: 12px 0; }}
.two {{ display: grid; grid-template-columns: minmax(0, 3fr) minmax(0, 2fr); gap: 26px; }}
.pair {{ display: grid; grid-template-columns: repeat(2, minmax(0, 1fr)); gap: 14px; }}
.three {{ display: grid; grid-template-columns: repeat(3, minmax(0, 1fr)); gap: 14px 16px; }}
.scroll {{ overflow-x: auto; margin: 8px 0; }} .numbers {{ width: auto; font-variant-numeric: tabular-nums; }}
.numbers th, .numbers td {{ text-align: right; padding: 4px 14px 4px 0; }} .numbers td {{ white-space: nowrap; }}
.numbers th:first-child, .numbers td:first-child {{ text-align: left; white-space: nowrap; }}
.numbers .group {{ text-align: center; border-left: 12px solid transparent; }}
dl {{ display: grid; grid-template-columns: max-content 1fr; gap: 3px 14px; margin: 4px 0; }}
dt {{ color: var(--dim); }} dd {{ margin: 0; }}
dd.Forward {{ font-family: ui-monospace, monospace; font-size: 12.5px; }}
.remains {{ background: var(--soft); border-left: 4px solid {GREEN}; border-radius: 6px; padding: 4px 16px 8px; }}
.remains.open {{ border-left-color: {RED}; }}
.next {{ border: 1px solid {BLUE}; border-left-width: 4px; border-radius: 6px; padding: 6px 14px; margin: 8px 0; }}
.next p {{ margin: 2px 0; }}
.next pre {{ margin: 2px 0 6px; padding: 6px 10px; background: var(--soft); border-radius: 4px; overflow-x: auto; }}
.next code {{ color: inherit; font-size: 12.5px; user-select: all; }}
details > summary {{ cursor: pointer; font-size: 15px; font-weight: 600; margin: 14px 0 4px; }}
.fold > summary {{ margin: 0; list-style-position: inside; }} .fold > summary > h2 {{ display: inline; }}
.fold {{ border-top: 1px solid var(--line); margin-top: 26px; }}
.fold > summary > h2 {{ border: 0; margin: 0; padding: 8px 0 4px; }}
.remains li {{ margin: 3px 0; }} ul {{ margin: 6px 0; padding-left: 20px; }}
figure {{ margin: 6px 0 2px; min-width: 0; }}
figcaption {{ color: var(--dim); font-size: 12px; }}
@media screen and (max-width: 1080px) {{ .first {{ grid-template-columns: minmax(0, 1fr); }} }}
@media screen and (max-width: 860px) {{
  body {{ padding: 10px 12px 30px; }} h1 {{ font-size: 21px; }}
  .first, .two, .pair, .three {{ grid-template-columns: minmax(0, 1fr); }}
  .fold {{ margin-top: 0; }} .fold > summary > h2 {{ font-size: 16px; padding: 9px 0; }}
  .chain {{ grid-template-columns: 1fr; gap: 0; }}
  .chain li {{ display: grid; grid-template-columns: 96px 1fr; border-radius: 0; padding: 3px 8px; }}
  .chain li + li::before {{ content: none; }} .chain b, .chain i {{ grid-column: 2; }} .chain span {{ grid-row: 1; }}
  .chain li.hit {{ padding: 3px 8px; }}
  dl {{ grid-template-columns: 1fr; gap: 0; }} dd {{ margin-bottom: 6px; }}
  table:not(.numbers), table:not(.numbers) > tbody, table:not(.numbers) > tbody > tr,
  table:not(.numbers) > tbody > tr > td {{ display: block; }}
  table:not(.numbers) > thead {{ display: none; }}
  table:not(.numbers) > tbody > tr {{ border-bottom: 2px solid var(--line); padding: 6px 0; }}
  table:not(.numbers) > tbody > tr > td {{ border: 0; padding: 2px 0; }}
  table.places > tbody > tr > td:not(:first-child) {{ display: inline-block; margin-right: 14px; }}
  .numbers th, .numbers td {{ padding-right: 10px; font-size: 12px; }}
  td[data-label]:not([data-label=""])::before {{ content: attr(data-label) ": "; color: var(--dim); font-size: 12px; }}
  td:first-child::before {{ content: none !important; }} table:not(.numbers) td:empty {{ display: none; }}
}}
@media screen and (prefers-color-scheme: dark) {{
  :root {{ color-scheme: dark; --line: #3b3f45; --soft: #1f2227; --dim: #a8aeb6; }}
  body {{ color: #e3e5e8; background: #15171b; }} a {{ color: #79b8ff; }}
  .chain i {{ color: #a8aeb6; }} .chain li.hit {{ background: #36231a; }} .bar {{ background: #3b3f45; }}
  figure [data-root-id] > * {{ filter: invert(0.91) hue-rotate(180deg); }}  /* figures are drawn for paper */
}}
@page {{ size: A4; margin: 12mm; }}
@media print {{
  body {{ zoom: {A4_ZOOM}; padding: 0; max-width: none; -webkit-print-color-adjust: exact; print-color-adjust: exact; }}
  figure, .card, tr, .remains {{ break-inside: avoid; }} h2, h3 {{ break-after: avoid; }}
}}
"""

TOUCH_SCRIPT = """
// On a touch screen a drag scrolls the page, so box zoom is off.
if (matchMedia("(pointer: coarse)").matches) {
  const timer = setInterval(() => {
    for (const one of Bokeh.documents) {
      for (const model of one._all_models.values()) if (model.type === "BoxZoomTool") model.active = false;
      clearInterval(timer);
    }
  }, 300);
}
"""

FOLD_SCRIPT = """
// A narrow screen begins with folded sections; paper has none.
const folds = document.querySelectorAll("details.fold");
if (matchMedia("screen and (max-width: 860px)").matches) for (const one of folds) one.open = false;
addEventListener("beforeprint", () => { for (const one of document.querySelectorAll("details")) one.open = true; });
"""

PRINT_SCRIPT = """
// Printing does not redraw a figure, so each is scaled to the width of its column.
const columns = {three: 3, pair: 2, first: 3};
addEventListener("beforeprint", () => {
  for (const one of document.querySelectorAll("figure [data-root-id] > *")) {
    const within = one.closest("figure").parentElement.className;
    const scale = PIXELS / (columns[within] ?? 1) / one.offsetWidth;
    if (Math.abs(scale - 1) > 0.1) one.style.zoom = scale;
  }
});
addEventListener("afterprint", () => {
  for (const one of document.querySelectorAll("figure [data-root-id] > *")) one.style.zoom = "";
});
""".replace("PIXELS", str(0.97 * A4_PIXELS))

PAGE_SCRIPT = FOLD_SCRIPT + TOUCH_SCRIPT + PRINT_SCRIPT

DATA_NOTE = "<p class='dim'>Data of the figures as CSV: folder <code>{folder}</code> beside this page.</p>"

PAGE_TEMPLATE = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; script-src 'unsafe-inline' 'unsafe-eval';
  style-src 'unsafe-inline'; img-src data: blob:">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<style>{style}</style>
</head>
<body>
<main>
{body}
</main>
{library}
{script}
<script>{own}</script>
</body>
</html>
"""
