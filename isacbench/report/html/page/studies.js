/* Studies: bit errors, false-alarm rates, resolution, efficiency. */

const STUDIES = { link: "Link", detection: "Detectors", resolution: "Resolution", efficiency: "Efficiency" };
const buildStudy = (root) => {
  const found = [];
  for (const [group, charts] of grouped(data.charts, (chart) => chart.group)) {
    const grid = h("div", { class: "grid" });
    root.append(heading(short(group, 120)), grid);
    for (const chart of charts) {
      const figure = new Figure({
        title: chart.title,
        label: `${chart.y.title} over ${chart.x.title}`,
        height: 400,
        table: seriesTable(chart.title, chart.x.title, chart.y.title, chart.series),
      });
      grid.append(figure.element);
      found.push([chart, figure]);
    }
  }
  return () => {
    for (const [chart, figure] of found) {
      const traces = chart.series.flatMap((series) => lineWithBand(series, series, chart.y.log));
      const line = { color: css("fg"), dash: "dash", width: 1.5 };
      const shapes = chart.lines.map((y) => ({ type: "line", xref: "paper", x0: 0, x1: 1, y0: y, y1: y, line }));
      let range = chart.y.range;
      if (chart.y.log) {
        const heights = [...chart.series.flatMap((series) => [...series.y, ...series.low, ...series.high]), ...chart.lines];
        const [low, high] = (range ?? extent(heights.filter((one) => one > 0))).map(Math.log10);
        if (range) range = [low, high];
        else if (low < Infinity) range = [Math.floor(low), Math.ceil(high)];
      }
      figure.draw(traces, {
        shapes,
        xaxis: axis(axisNote(chart.x.title, chart.x.log)),
        yaxis: axis({ ...axisNote(chart.y.title, chart.y.log), ...(range ? { range } : {}) }),
        hovermode: "closest",
      });
    }
  };
};
