"""Template, style and script of the live page. The page warns when its values are out of date."""

from piezod.report.style import PAGE_CSS, TOUCH_SCRIPT

LIVE_CSS = (
    PAGE_CSS
    + """
.stale { display: none; position: sticky; top: 0; z-index: 10; background: #b84e00; color: #fff; padding: 6px 12px;
  border-radius: 6px; font-weight: 600; }
.stale.shown { display: block; }
h1 { margin-bottom: 8px; } h2 { font-size: 15px; margin: 14px 0 4px; padding: 0; border: 0; }
.live { display: grid; grid-template-columns: minmax(0, 3fr) minmax(0, 2fr); gap: 0 22px; align-items: start; }
.commands { border: 1px solid var(--line); border-radius: 6px; padding: 6px 12px; margin: 10px 0; }
@media (max-width: 860px) { .live { grid-template-columns: minmax(0, 1fr); } }
"""
)

# Without updates the script shows a warning, and reloads the page as soon as the server answers.
LIVE_SCRIPT = (
    TOUCH_SCRIPT
    + """
const STALE_AFTER_MS = 3000, TRY_EVERY_MS = 2000;
let updated = Date.now(), watched = null, asked = false;
function watchDocument() {
  const found = Bokeh.documents.find((one) => one.get_model_by_name("banner"));
  if (!found || found === watched) return;
  watched = found;
  found.on_change(() => { updated = Date.now(); });
}
setInterval(watchDocument, 200);
setInterval(() => {
  const age = Date.now() - updated;
  const warning = document.getElementById("stale");
  warning.className = age > STALE_AFTER_MS ? "stale shown" : "stale";
  if (age > STALE_AFTER_MS)
    warning.textContent = `No update for ${Math.round(age / 1000)} s: the values are out of date`;
}, 500);
setInterval(() => {
  if (asked || Date.now() - updated < STALE_AFTER_MS + TRY_EVERY_MS || document.hidden) return;
  asked = true;  // one at a time: a further one would begin the reload of a slow server anew, for ever
  fetch(location.href, {cache: "no-store"}).then(
    (answer) => { if (answer.ok) location.reload(); else asked = false; }, () => { asked = false; });
}, TRY_EVERY_MS);
"""
)

TEMPLATE = """{% extends base %}
{% block postamble %}
<meta name="viewport" content="width=device-width, initial-scale=1">
<style>{{ style }}</style>
{% endblock %}
{% block contents %}
<main>
<div id="stale" class="stale" role="alert"></div>
<h1>{{ bench | e }}</h1>
{{ embed(roots.banner) }}
{% if commands %}<div class="commands">{{ embed(roots.buttons) }}{{ embed(roots.result) }}</div>{% endif %}
<div class="live">
<div>
<figure>{{ embed(roots.force) }}</figure>
<figure>{{ embed(roots.error) }}</figure>
<figure>{{ embed(roots.voltage) }}</figure>
</div>
<div>
<figure>{{ embed(roots.curve) }}</figure>
<h2>Last events</h2>
{{ embed(roots.events) }}
</div>
</div>
<div class="pair">
<figure>{{ embed(roots.lateness) }}</figure>
<figure>{{ embed(roots.exchange) }}</figure>
</div>
<p class="dim">Dashed lines: voltage limits, and the tick period. Histograms and curves over time cover the
last 30 seconds. Curves over time show the smallest and the largest value of every {{ segment_ms }} ms.</p>
</main>
<script>{{ script }}</script>
{% endblock %}
"""
