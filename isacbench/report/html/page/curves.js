/* Curves over SNR; a point opens its trials. */

/* Whether a row is of a scene, or without one of the chosen family. */
const isOf = (scene, row) =>
  scene === "" ? !state.family || data.scenes[data.rows.scene[row]].family === state.family : sceneName(row) === scene;
const curveOf = (scene, estimator, metric) => {
  const rows = rowsWhere((row) => data.rows.estimator[row] === estimator && isOf(scene, row) && isScored(row));
  const isMany = scene === "" && unique(rows.map((row) => data.rows.scene[row])).length > 1;
  const points = [...grouped(rows, (row) => value("snr_db", row))]
    .sort(([a], [b]) => a - b)
    .map(([snr, own]) => ({ snr, ...summary(own, metric, isMany) }))
    .filter((point) => point.mean !== null);
  return {
    label: labelOf(estimator),
    x: points.map((point) => point.snr),
    y: points.map((point) => point.mean),
    low: points.map((point) => (point.band === null ? null : point.mean - point.band)),
    high: points.map((point) => (point.band === null ? null : point.mean + point.band)),
  };
};

/* The SNR of a median scatterer, which the axis of a single scene tells. */
const afterGains = (name) => {
  const gain = data.scenes.find((scene) => scene.name === name)?.gain_db;
  return Number.isFinite(gain) ? `; ${told(gain, 3)} dB more after all gains, for a median scatterer` : "";
};

const buildCurves = (root) => {
  const chosen = h("div"),
    charts = h("div", { class: "grid wide" });
  const preset = data.scenes.length > 12 ? EVERY : data.scenes[0].name;
  const first = () => ((state.scene ?? preset) === EVERY ? "" : (state.scene ?? preset));
  root.append(
    controls(
      familyControl(),
      selectControl(
        "scene",
        "Scene",
        () => [...(data.scenes.length > 1 ? [[EVERY, `mean over ${state.family || "all"} scenes`]] : []), ...sceneOptions()],
        preset,
        () => ({ family: state.family ?? "" }),
      ),
      selectControl("metric", "Metric", () => [["every", "every metric"], ...metricOptions()], data.metric),
      estimatorsControl(),
    ),
    charts,
    chosen,
  );
  let figures = [],
    key = "";
  return () => {
    const scene = first(),
      isEvery = state.metric === "every",
      metrics = isEvery ? data.metrics : [metricOf(ranked())];
    const shown = estimatorNumbers().filter((one) => chosenEstimators().includes(labelOf(one)));
    const wanted = metrics.map((metric) => metric.name).join();
    if (key !== wanted) {
      figures = metrics.map(
        (metric) =>
          new Figure({
            title: metric.title,
            label: `${metric.title} over SNR, a line for each estimator`,
            height: isEvery ? 290 : 430,
            onClick: (point) => setState({ point: `${point.customdata}|${point.data.legendgroup}`, est: state.est }, true),
          }),
      );
      charts.replaceChildren(...figures.map((figure) => figure.element));
      key = wanted;
    }
    metrics.forEach((metric, i) => {
      const series = shown.map((one) => curveOf(scene, one, metric)),
        figure = figures[i];
      figure.note.textContent = `${scene === "" ? "means over scenes" : short(scene)}; bands are 95 % intervals${scene !== "" && data.estimators.some((own) => own.is_reference) ? ", of references the spread over realisations" : ""}; ${metric.better === "neither" ? "" : `${metric.better} is better. `}A click on a point shows its trials.`;
      figure.table = seriesTable(`${metric.title}, ${scene || "mean over scenes"}`, "SNR [dB]", metric.name, series);
      figure.draw(
        series.flatMap((one, place) => lineWithBand(one, data.estimators[shown[place]], metric.log)),
        {
          xaxis: axis({ title: { text: `SNR [dB]${afterGains(scene)}` } }),
          yaxis: axis({ ...axisNote(metric.axis, metric.log), rangemode: metric.log ? "normal" : "tozero" }),
          hovermode: "closest",
          showlegend: !isEvery || i === 0,
        },
      );
    });
    const [snr, ...rest] = (state.point ?? "").split("|"),
      label = rest.join("|");
    const numbers = shown.filter((one) => labelOf(one) === label);
    const at = state.point && numbers.length ? Number(snr) : null;
    const rows = rowsWhere(
      (row) =>
        (at === null || (value("snr_db", row) === at && data.rows.estimator[row] === numbers[0])) &&
        shown.includes(data.rows.estimator[row]) &&
        isOf(scene, row),
    );
    const shownMetrics = metrics.slice(0, 6);
    const snrSelect = h(
      "select",
      { "data-key": "point", onchange: () => setState({ point: snrSelect.value }, true) },
      h("option", { value: "" }, "all points"),
      shown.flatMap((one) =>
        data.snrs.map((db) => h("option", { value: `${db}|${labelOf(one)}` }, `${short(labelOf(one), 40)} at ${db} dB`)),
      ),
    );
    snrSelect.value = at === null ? "" : state.point;
    chosen.replaceChildren(
      heading(at === null ? "Trials" : `Trials of ${short(label)} at ${snr} dB`),
      controls(labelled("Point", snrSelect)),
      dataTable({
        caption: "A trial opens its image",
        name: "trials",
        columns: [
          ...cellColumns(),
          ...shownMetrics.map(({ name, title }) => ({ title: name, about: title, get: (row) => value(name, row) })),
        ],
        rows,
        page: 20,
        first: `${shownMetrics[0].name}|${shownMetrics[0].better === "higher" ? "up" : "down"}`,
      }),
    );
  };
};
