"""The page around the figures: the look of the reports, and a word when no news comes."""

from piezod.report.style import STYLE

LIVE_STYLE = (
    STYLE
    + """
.news { display: none; position: sticky; top: 0; z-index: 10; background: #b84e00; color: #fff; padding: 6px 12px;
  border-radius: 6px; font-weight: 600; }
.news.late { display: block; }
h1 { margin-bottom: 8px; }
.live { display: grid; grid-template-columns: minmax(0, 3fr) minmax(0, 2fr); gap: 0 22px; align-items: start; }
.desk { border: 1px solid var(--line); border-radius: 6px; padding: 6px 12px; margin: 10px 0; }
@media (max-width: 860px) { .live { grid-template-columns: minmax(0, 1fr); } }
"""
)

# A page that shows old values as if they were new is worse than none: it says so, and begins again when it can.
LIVE_SCRIPT = """
const LATE_AFTER_MS = 3000, TRY_EVERY_MS = 2000;
let heard = Date.now(), following = null;
function follow() {
  const found = Bokeh.documents.find((one) => one.get_model_by_name("lamp"));
  if (!found || found === following) return;
  following = found;
  found.on_change(() => { heard = Date.now(); });
}
setInterval(follow, 200);
setInterval(() => {
  const late = Date.now() - heard > LATE_AFTER_MS;
  const news = document.getElementById("news");
  news.className = late ? "news late" : "news";
  if (late) news.textContent = `No news for ${Math.round((Date.now() - heard) / 1000)} s: what stands here is old`;
}, 500);
setInterval(() => {
  if (Date.now() - heard < LATE_AFTER_MS + TRY_EVERY_MS || document.hidden) return;
  fetch(location.href, {cache: "no-store"}).then((answer) => { if (answer.ok) location.reload(); }, () => {});
}, TRY_EVERY_MS);
"""

TEMPLATE = """{% extends base %}
{% block postamble %}
<meta name="viewport" content="width=device-width, initial-scale=1">
<style>{{ style }}</style>
{% endblock %}
{% block contents %}
<div id="news" class="news" role="alert"></div>
<h1>{{ bench | e }}</h1>
{{ embed(roots.lamp) }}
{% if desk %}<div class="desk">{{ embed(roots.desk) }}{{ embed(roots.said) }}</div>{% endif %}
<div class="live">
<div>
<figure>{{ embed(roots.force) }}</figure>
<figure>{{ embed(roots.error) }}</figure>
<figure>{{ embed(roots.voltage) }}</figure>
</div>
<div>
<figure>{{ embed(roots.curve) }}</figure>
<h3>Last events</h3>
{{ embed(roots.events) }}
</div>
</div>
<div class="pair">
<figure>{{ embed(roots.lateness) }}</figure>
<figure>{{ embed(roots.exchange) }}</figure>
</div>
<p class="dim">Dashed: voltage limits, and one period of the tick. Curves over time go back half a minute, with the
smallest and the largest value of every {{ bucket_ms }} ms; histograms are of the same half minute.</p>
<script>{{ script }}</script>
{% endblock %}
"""
