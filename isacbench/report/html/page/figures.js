/* Figures by plotly: themed, with a table, and saved as SVG or PNG. */

let loading = null;
const plotly = () =>
  (loading ??= unpack("plotly").then((bytes) => {
    const script = h("script");
    script.textContent = new TextDecoder().decode(bytes);
    document.head.append(script);
    return window.Plotly;
  }));

const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
const isDark = () => matchMedia("(prefers-color-scheme: dark)").matches && !matchMedia("print").matches;
/* Okabe and Ito's blue is too dark on black. */
const DARK = { "#0072B2": "#4FA8E0" };
const colourOf = (look) => (look.colour ? (isDark() && DARK[look.colour]) || look.colour : css("fg"));
const faint = (colour, alpha) => {
  const [r, g, b] = [1, 3, 5].map((at) => parseInt(colour.slice(at, at + 2), 16));
  return `rgba(${r},${g},${b},${alpha})`;
};

const axis = (more = {}) => ({
  gridcolor: css("line"),
  linecolor: css("muted"),
  zerolinecolor: css("line"),
  tickcolor: css("muted"),
  showline: true,
  automargin: true,
  ...more,
});
const layoutOf = (more = {}) => ({
  paper_bgcolor: "rgba(0,0,0,0)",
  plot_bgcolor: "rgba(0,0,0,0)",
  font: { color: css("fg"), size: 12, family: "system-ui, sans-serif" },
  margin: { l: 55, r: 12, t: 28, b: 45 },
  hoverlabel: { bgcolor: css("panel"), bordercolor: css("muted"), font: { color: css("fg") } },
  legend: { orientation: "h", y: 1.02, yanchor: "bottom" },
  ...more,
});
const CONFIG = { displayModeBar: false, responsive: true, showSendToCloud: false };

const drawn = new Set();
const forget = () => {
  for (const plot of drawn) if (window.Plotly) window.Plotly.purge(plot);
  drawn.clear();
};

/* A figure; draw() takes traces and layout. */
class Figure {
  constructor({ title, label, height = 340, table = null, name = null, onClick = null, keys = null, note = null }) {
    this.plot = h("div", { class: "plot", role: "img", "aria-label": label ?? title, style: { height: `${height}px` } });
    this.heading = h("h3", {}, title);
    this.note = h("p", { class: "note" }, note);
    this.onClick = onClick;
    this.name = () => name ?? this.heading.textContent;
    this.listens = false;
    if (keys) {
      this.plot.tabIndex = 0;
      this.plot.setAttribute("role", "application");
      this.plot.addEventListener("keydown", keys);
    }
    this.tableBox = h("div");
    this.table = table;
    const saves = ["svg", "png"].map((format) =>
      h("button", { type: "button", onclick: () => this.save(format) }, `Save ${format.toUpperCase()}`),
    );
    this.element = h("figure", {}, this.heading, this.note, this.plot, h("div", { class: "tools" }, saves), this.tableBox);
  }

  async draw(traces, layout) {
    if (this.table) this.tableBox.replaceChildren(tableBelow(this.table));
    this.latest = [traces, layout];
    if (this.isBusy) return; // the loop below draws it next, and nothing between
    this.isBusy = true;
    const Plotly = await plotly();
    while (this.latest && this.plot.isConnected) {
      const [own, wanted] = this.latest;
      this.latest = null;
      drawn.add(this.plot);
      await Plotly.react(this.plot, own, layoutOf(wanted), CONFIG);
      if (!this.listens && this.onClick) this.plot.on("plotly_click", (event) => this.onClick(event.points[0]));
      if (!this.listens) this.whenDrawn?.(this.plot);
      this.listens = true;
    }
    this.isBusy = false;
  }

  clear() {
    this.latest = null;
    this.tableBox.replaceChildren();
    if (window.Plotly && drawn.delete(this.plot)) window.Plotly.purge(this.plot);
    this.listens = false;
  }

  async save(format) {
    const Plotly = await plotly();
    const { width, height } = this.plot.getBoundingClientRect();
    const address = await Plotly.toImage(this.plot, { format, width, height, scale: format === "png" ? 2 : 1 });
    saveFile(fileName(this.name(), format), address);
  }
}

/* Traces of a line with its band. */
const lineWithBand = (series, look, isLog = false) => {
  const colour = colourOf(look),
    traces = [];
  const has = (one) => one !== null && one !== undefined && (!isLog || one > 0);
  const places = series.x
    .map((_, i) => i)
    .filter((i) => has(series.low?.[i] ?? null) || (isLog && has(series.y[i]) && has(series.high?.[i])));
  const banded = places.filter((i) => has(series.high?.[i]));
  if (banded.length) {
    const low = banded.map((i) => (isLog && !(series.low[i] > 0) ? series.y[i] / 10 : series.low[i]));
    traces.push({
      x: [...banded.map((i) => series.x[i]), ...banded.map((i) => series.x[i]).reverse()],
      y: [...banded.map((i) => series.high[i]), ...low.reverse()],
      type: "scatter",
      mode: "lines",
      fill: "toself",
      fillcolor: faint(colour, 0.16),
      line: { width: 0 },
      hoverinfo: "skip",
      showlegend: false,
      legendgroup: series.label,
    });
  }
  traces.push({
    x: series.x,
    y: series.y.map((one) => (has(one) ? one : null)),
    type: "scatter",
    mode: [look.dash ? "lines" : "", look.symbol || series.x.length === 1 ? "markers" : ""].filter(Boolean).join("+"),
    name: plain(series.label),
    legendgroup: series.label,
    line: { color: colour, dash: look.dash, width: 1.8 },
    marker: { symbol: look.symbol || "circle", size: 7, color: colour },
    customdata: series.keys ?? series.x,
    hovertemplate: series.x.map(
      (_, i) =>
        `${plain(series.label).replaceAll("%{", "% {")}<br>%{x}: %{y:.4g}${has(series.high?.[i]) ? ` (${told(series.low?.[i])} to ${told(series.high[i])})` : ""}<extra></extra>`,
    ),
  });
  return traces;
};

const axisNote = (title, isLog) => ({
  title: { text: plain(title, 80) },
  type: isLog ? "log" : "linear",
  ...(isLog ? { exponentformat: "power", dtick: undefined } : {}),
});

const seriesTable = (caption, xTitle, yTitle, series) => () =>
  dataTable({
    caption,
    name: caption,
    columns: ["line", xTitle, yTitle, "from", "to"].map((title, at) => ({ title, get: (row) => row[at], isText: !at })),
    rows: series.flatMap((one) => one.x.map((x, i) => [one.label, x, one.y[i], one.low?.[i] ?? null, one.high?.[i] ?? null])),
  });
