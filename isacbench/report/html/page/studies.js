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
      const shapes = chart.lines.map((value) => ({
        type: "line",
        xref: "paper",
        x0: 0,
        x1: 1,
        y0: value,
        y1: value,
        line: { color: css("fg"), dash: "dash", width: 1.5 },
      }));
      const heights = [...chart.series.flatMap((series) => [...series.y, ...series.low, ...series.high]), ...chart.lines].filter(
        (one) => one > 0,
      );
      const decades =
        chart.y.log && heights.length ? [Math.floor(Math.log10(Math.min(...heights))), Math.ceil(Math.log10(Math.max(...heights)))] : null;
      const range = chart.y.range ? (chart.y.log ? chart.y.range.map(Math.log10) : chart.y.range) : decades;
      figure.draw(traces, {
        shapes,
        xaxis: axis(axisNote(chart.x.title, chart.x.log)),
        yaxis: axis({ ...axisNote(chart.y.title, chart.y.log), ...(range ? { range } : {}) }),
        hovermode: "closest",
      });
    }
  };
};
