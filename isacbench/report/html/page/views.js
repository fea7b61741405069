/* The views. Each builds its controls once, and returns what it draws anew whenever the state changes. */

const heading = (text) => h("h2", {}, text);
const numbersOf = (name, rows) => unique(rows.map((row) => value(name, row))).sort((a, b) => a - b);
const sceneOptions = () => data.scenes.map((scene) => [scene.name, scene.name]);
const imagedScenes = () => data.scenes.filter((scene) => scene.truth.length).map((scene) => [scene.name, scene.name]);
const families = () => unique(data.scenes.map((scene) => scene.family ?? "")).filter(Boolean);
const metricOptions = () => data.metrics.map((metric) => [metric.name, metric.title]);
const estimatorOptions = () => data.estimators.map((own) => [own.label, own.label, colourOf(own)]);
const estimatorNumbers = () => data.estimators.map((_, i) => i);
const ranked = () => state.metric ?? data.metric;
const hasTrials = () => data.rows.estimator.length > 0;

/* Rows that the filters of the state let through. */
const filteredRows = (names = ["family", "scene", "snr"]) =>
  rowsWhere(
    (row) =>
      (!names.includes("family") || !state.family || data.scenes[data.rows.scene[row]].family === state.family) &&
      (!names.includes("scene") || !state.scene || sceneName(row) === state.scene) &&
      (!names.includes("snr") || !state.snr || value("snr_db", row) === Number(state.snr)) &&
      (!names.includes("est") || !state.est.length || state.est.includes(labelOf(data.rows.estimator[row]))) &&
      (!names.includes("status") || !state.status || value("status", row) === state.status),
  );

const familyControl = () => (families().length > 1 ? selectControl("family", "Family", () => [["", "all families"], ...families().map((one) => [one, one])], "", () => ({ scene: "" })) : null);
const sceneControl = () => (data.scenes.length > 1 ? selectControl("scene", "Scene", () => [["", `all ${data.scenes.length} scenes`], ...sceneOptions().filter(([name]) => !state.family || data.scenes[data.sceneNumber.get(name)].family === state.family)]) : null);
const snrControl = () => selectControl("snr", "SNR", () => [["", "all SNRs"], ...data.snrs.map((snr) => [snr, `${snr} dB`])]);
const metricControl = () => selectControl("metric", "Metric", metricOptions, data.metric);
const controls = (...own) => h("div", { class: "controls", role: "group", "aria-label": "Choices" }, own);

/* Overview: facts, estimators ranked, failures. */

const factsOf = () => {
  const failed = rowsWhere((row) => !isScored(row)).length;
  const facts = data.runs[0].facts;
  const listed = [["scenes", data.scenes.length], ["estimators", data.estimators.length], ["SNRs", data.snrs.length], ["cells", data.n], ["failed", failed], ["suite", facts.suite], ["isacbench", facts.isacbench], ["started", facts.started.slice(0, 16).replace("T", " ")]];
  return h("dl", { class: "facts" }, listed.map(([name, own]) => h("div", {}, h("dt", {}, name), h("dd", { class: name === "failed" && own ? "bad" : null }, String(own)))));
};

const rankGroup = () => (state.scene || state.snr ? null : state.family ? `${state.family} scenes` : "all scenes");
const rankRows = (metric) => {
  const ranking = data.ranks[metric], group = rankGroup();
  return ranking?.ranks && group ? ranking.ranks.filter((row) => row.group === group) : [];
};
const rankText = (row) => (!row || row.rank_low === null ? "" : row.rank_low === row.rank_high ? `${row.rank_low}` : `${row.rank_low} to ${row.rank_high}`);

const drawOverview = (box) => {
  const rows = filteredRows(), scenes = unique(rows.map((row) => data.rows.scene[row])), overScenes = scenes.length >= 6;
  const byEstimator = grouped(rows, (row) => data.rows.estimator[row]), metric = metricOf(ranked()), sets = rankRows(metric.name);
  const listed = estimatorNumbers().filter((one) => byEstimator.has(one)).map((one) => {
    const own = byEstimator.get(one);
    return { estimator: one, rows: own, failed: own.filter((row) => !isScored(row)).length, set: sets.find((row) => row.estimator === one), of: Object.fromEntries(data.metrics.map((each) => [each.name, summary(own, each, overScenes)])) };
  });
  const sign = metric.better === "higher" ? "down" : "up";
  const shown = data.metrics.filter((each) => each.name === metric.name || ["deviation", "hausdorff_sum_m", "ratio", "precision", "recall", "gospa_m", "time_estimate_s"].includes(each.name)).sort((a, b) => (b.name === metric.name) - (a.name === metric.name));
  const columns = [
    { title: "estimator", isText: true, get: (row) => labelOf(row.estimator), show: (row) => nameCell(row.estimator) },
    data.runs.length > 1 ? { title: "run", isText: true, get: (row) => data.runs[data.estimators[row.estimator].run].name } : null,
    sets.length ? { title: "rank", about: `Set of ranks by ${metric.title}, simultaneous 95 % confidence`, get: (row) => row.set?.rank_low ?? null, show: (row) => (row.set?.is_reference ? "reference" : rankText(row.set)) } : null,
    ...shown.flatMap((each) => [{ title: each.name, about: `${each.title}, ${each.better} is better`, get: (row) => row.of[each.name].mean, show: (row) => withBand(row.of[each.name]) }]),
    { title: "failed", get: (row) => row.failed, show: (row) => (row.failed ? h("span", { class: "bad" }, `${row.failed} of ${row.rows.length}`) : "0") },
    { title: "cells", get: (row) => row.rows.length },
  ].filter(Boolean);
  const where = [state.scene || (state.family ? `${state.family} scenes` : counted(scenes.length, "scene")), state.snr ? `${state.snr} dB` : "all SNRs"].join(", ");
  const unit = overScenes ? "means over scenes ± 95 % interval over scenes" : "means over trials ± 95 % interval over trials";
  const table = dataTable({ caption: `${where}; ${unit}${listed.some((row) => data.estimators[row.estimator].is_reference) ? "; ± of references: spread over realisations" : ""}`, name: `estimators ${where}`, columns, rows: listed, sortKey: "sort", first: `${metric.name}|${sign}`, rowClass: (row) => (data.estimators[row.estimator].is_reference ? "reference" : null) });
  const order = [...listed].filter((row) => row.of[metric.name].mean !== null).sort((a, b) => (metric.better === "higher" ? 1 : -1) * (a.of[metric.name].mean - b.of[metric.name].mean));
  const parts = [table];
  const reason = data.ranks[metric.name]?.reason ?? Object.values(data.ranks).find((one) => one.reason)?.reason;
  if (!sets.length) parts.push(h("p", { class: "note" }, data.ranks[metric.name]?.ranks ? "Rank sets are over all SNRs, and over all scenes or families of 20 scenes or more." : `No rank sets: ${reason ? short(reason, 600) : "they are made of deviation, Hausdorff sum, ratio and GOSPA, and of the metric of isacbench rank"}`));
  for (const note of data.ranks[metric.name]?.notes ?? []) parts.push(h("p", { class: "note" }, note));
  const figure = new Figure({ title: `${metric.title}: ${where}`, label: `${metric.title} of each estimator with its interval`, height: 90 + 30 * order.length, table: () => dataTable({ caption: metric.title, name: metric.name, columns: columns.filter((column) => ["estimator", metric.name].includes(column.title)), rows: order }) });
  parts.push(figure.element);
  box.replaceChildren(...parts, ...winTable(metric.name), ...worstTable(metric.name), failureTable(rows));
  figure.draw(
    order.map((row) => {
      const look = data.estimators[row.estimator], own = row.of[metric.name], colour = colourOf(look);
      return { type: "scatter", mode: "markers", x: [own.mean], y: [plain(look.label)], marker: { size: 10, color: colour, symbol: look.symbol || "line-ns-open" }, error_x: { type: "data", array: [own.band ?? 0], color: colour, thickness: 2 }, hovertemplate: "%{x:.4g}<extra></extra>", showlegend: false };
    }),
    { xaxis: axis({ ...axisNote(metric.axis, false), rangemode: "tozero" }), yaxis: axis({ automargin: true }), margin: { l: 30, r: 20, t: 8, b: 45 } },
  );
};

const winTable = (metric) => {
  const ranking = data.ranks[metric], group = rankGroup();
  const wins = ranking?.wins && group ? ranking.wins.filter((row) => row.group === group) : [];
  if (!wins.length) return [];
  const numbers = unique(wins.map((row) => row.estimator));
  const find = (one, other) => wins.find((row) => row.estimator === one && row.other === other);
  const columns = [{ title: "better", isText: true, get: (one) => labelOf(one), show: (one) => nameCell(one) }];
  for (const other of numbers)
    columns.push({ title: labelOf(other), get: (one) => find(one, other)?.probability ?? null, show: (one) => { const own = find(one, other); return own ? [told(own.probability, 2), h("span", { class: "band" }, ` (${told(own.low, 2)} to ${told(own.high, 2)})`)] : ""; } });
  return [heading("Win probabilities"), dataTable({ caption: `Probability that the row is better than the column by ${metric} on an unseen scene, 95 % interval; ${group}`, name: `wins ${metric}`, columns, rows: numbers })];
};

const imageLink = (scene, snr, trial, estimators, text) => h("a", { href: linkTo("images", { scene, snr, trial, est: estimators, family: "" }) }, text);

const worstTable = (metric) => {
  const worst = data.ranks[metric]?.worst ?? [];
  if (!worst.length || !rankGroup()) return [];
  const columns = [
    { title: "estimator", isText: true, get: (row) => labelOf(row.estimator), show: (row) => nameCell(row.estimator) },
    { title: "scene", isText: true, get: (row) => row.scenario, show: (row) => imageLink(row.scenario, row.snr_db, row.trial, [labelOf(row.estimator)], short(row.scenario)) },
    { title: metric, get: (row) => row.score },
    { title: "worst image", get: (row) => row.cell_score },
    { title: "SNR [dB]", get: (row) => row.snr_db },
    { title: "command", isText: true, style: "command", get: (row) => row.command },
  ];
  return [heading("Worst scenes"), dataTable({ caption: `Scenes in which each estimator is worst by ${metric}`, name: `worst ${metric}`, columns, rows: worst })];
};

const failureTable = (rows) => {
  const failed = rows.filter((row) => !isScored(row));
  if (!failed.length) return h("p", { class: "note" }, "No cell failed.");
  const columns = [...cellColumns(), { title: "reason", isText: true, get: (row) => value("reason", row) }];
  return h("section", {}, heading(`Failed cells: ${failed.length}`), dataTable({ caption: "Cells without a score, with the reason", name: "failed cells", columns, rows: failed }));
};

const cellColumns = () => [
  { title: "scene", isText: true, get: sceneName },
  { title: "estimator", isText: true, get: (row) => labelOf(data.rows.estimator[row]), show: (row) => nameCell(data.rows.estimator[row]) },
  { title: "SNR [dB]", get: (row) => value("snr_db", row) },
  { title: "trial", get: (row) => value("trial", row), show: (row) => (data.rows.has_image[row] ? imageLink(sceneName(row), value("snr_db", row), value("trial", row), [labelOf(data.rows.estimator[row])], `${value("trial", row)}, image`) : String(value("trial", row))) },
  { title: "status", isText: true, get: (row) => value("status", row), show: (row) => h("span", { class: isScored(row) ? null : "bad" }, value("status", row)) },
];

const factTables = () =>
  data.runs.map((run) =>
    h("details", {}, h("summary", {}, data.runs.length > 1 ? `About the run ${short(run.name)}` : "About the run: command, machine, versions"), h("div", { class: "scroll" }, h("table", {}, h("tbody", {}, Object.entries(run.facts).map(([name, own]) => h("tr", {}, h("th", { scope: "row", class: "text" }, name), h("td", { class: "text" }, own))))))),
  );
const parameterTable = () => h("details", {}, h("summary", {}, "Parameters of the estimators"), dataTable({ caption: "Parameters as the rows have them", name: "parameters", columns: [{ title: "estimator", isText: true, get: (one) => labelOf(one), show: (one) => nameCell(one) }, { title: "parameters", isText: true, style: "command", get: (one) => data.estimators[one].params }], rows: estimatorNumbers() }));

/* Curves over SNR; a point opens its trials. */

const curveOf = (scene, estimator, metric) => {
  const rows = rowsWhere((row) => data.rows.estimator[row] === estimator && (scene === "" ? !state.family || data.scenes[data.rows.scene[row]].family === state.family : sceneName(row) === scene) && isScored(row));
  const isMany = scene === "" && unique(rows.map((row) => data.rows.scene[row])).length > 1;
  const points = [...grouped(rows, (row) => value("snr_db", row))].sort(([a], [b]) => a - b).map(([snr, own]) => ({ snr, ...summary(own, metric, isMany) })).filter((point) => point.mean !== null);
  return { label: labelOf(estimator), x: points.map((point) => point.snr), y: points.map((point) => point.mean), low: points.map((point) => (point.band === null ? null : point.mean - point.band)), high: points.map((point) => (point.band === null ? null : point.mean + point.band)) };
};

const buildCurves = (root) => {
  const chosen = h("div"), charts = h("div", { class: "grid wide" });
  const first = () => state.scene ?? (data.scenes.length > 12 ? "" : data.scenes[0].name);
  root.append(
    controls(
      familyControl(),
      selectControl("scene", "Scene", () => [...(data.scenes.length > 1 ? [["", `mean over ${state.family || "all"} scenes`]] : []), ...sceneOptions()], data.scenes.length > 12 ? "" : data.scenes[0].name),
      selectControl("metric", "Metric", () => [["every", "every metric"], ...metricOptions()], data.metric),
      checksControl("est", "Estimators", estimatorOptions, () => (state.est.length ? state.est : data.estimators.map((own) => own.label))),
    ),
    charts,
    chosen,
  );
  let figures = [], key = "";
  return () => {
    const scene = first(), isEvery = state.metric === "every", metrics = isEvery ? data.metrics : [metricOf(ranked())];
    const names = state.est.length ? state.est : data.estimators.map((own) => own.label);
    const shown = estimatorNumbers().filter((one) => names.includes(labelOf(one)));
    if (key !== metrics.map((metric) => metric.name).join()) {
      figures = metrics.map((metric) => new Figure({ title: metric.title, label: `${metric.title} over SNR, a line for each estimator`, height: isEvery ? 290 : 430, onClick: (point) => setState({ point: `${point.customdata}|${point.data.legendgroup}`, est: state.est }, true) }));
      charts.replaceChildren(...figures.map((figure) => figure.element));
      key = metrics.map((metric) => metric.name).join();
    }
    metrics.forEach((metric, i) => {
      const series = shown.map((one) => curveOf(scene, one, metric)), figure = figures[i];
      figure.note.textContent = `${scene === "" ? "means over scenes" : short(scene)}; bands are 95 % intervals${scene !== "" && data.estimators.some((own) => own.is_reference) ? ", of references the spread over realisations" : ""}; ${metric.better} is better. A click on a point shows its trials.`;
      figure.table = seriesTable(`${metric.title}, ${scene || "mean over scenes"}`, "SNR [dB]", metric.name, series);
      figure.draw(series.flatMap((one, place) => lineWithBand(one, data.estimators[shown[place]], metric.log)), { xaxis: axis({ title: { text: "SNR [dB]" } }), yaxis: axis({ ...axisNote(metric.axis, metric.log), rangemode: metric.log ? "normal" : "tozero" }), hovermode: "closest", showlegend: !isEvery || i === 0 });
    });
    const [snr, ...rest] = (state.point ?? "").split("|"), label = rest.join("|");
    const numbers = shown.filter((one) => labelOf(one) === label);
    const at = state.point && numbers.length ? Number(snr) : null;
    const rows = rowsWhere((row) => (at === null || (value("snr_db", row) === at && data.rows.estimator[row] === numbers[0])) && shown.includes(data.rows.estimator[row]) && (scene === "" ? !state.family || data.scenes[data.rows.scene[row]].family === state.family : sceneName(row) === scene));
    const shownMetrics = metrics.slice(0, 6);
    const snrSelect = h("select", { onchange: () => setState({ point: snrSelect.value }, true) }, h("option", { value: "" }, "all points"), shown.flatMap((one) => data.snrs.map((db) => h("option", { value: `${db}|${labelOf(one)}` }, `${short(labelOf(one), 40)} at ${db} dB`))));
    snrSelect.value = at === null ? "" : state.point;
    chosen.replaceChildren(
      heading(at === null ? "Trials" : `Trials of ${short(label)} at ${snr} dB`),
      controls(labelled("Point", snrSelect)),
      dataTable({ caption: "A trial opens its image", name: "trials", columns: [...cellColumns(), ...shownMetrics.map((metric) => ({ title: metric.name, about: metric.title, get: (row) => value(metric.name, row) }))], rows, page: 20, first: `${shownMetrics[0].name}|${shownMetrics[0].better === "higher" ? "up" : "down"}` }),
    );
  };
};

/* Images. */

const imageState = () => {
  const imaged = data.scenes.findIndex((scene) => scene.name === state.scene && scene.truth.length);
  const scene = imaged >= 0 ? imaged : data.scenes.findIndex((one) => one.truth.length);
  const rows = rowsWhere((row) => data.rows.scene[row] === scene);
  const snrs = numbersOf("snr_db", rows), trials = numbersOf("trial", rows);
  const near = (values, wanted) => values.reduce((best, one) => (Math.abs(one - wanted) < Math.abs(best - wanted) ? one : best), values[0]);
  const snr = near(snrs, state.snr ? Number(state.snr) : data.shown_snr_db), trial = near(trials, Number(state.trial ?? trials[0]));
  const own = unique(rows.map((row) => data.rows.estimator[row]));
  const wanted = own.filter((one) => state.est.includes(labelOf(one)));
  const score = (one) => { const row = rowAt(scene, one, snr, trial); return (row === null ? null : value("deviation", row)) ?? Infinity; };
  const best = own.filter((one) => !data.estimators[one].is_reference).sort((a, b) => score(a) - score(b));
  const estimators = (wanted.length ? wanted : (best.length ? best : own).slice(0, 2)).slice(0, MOST_SHOWN);
  return { scene, snrs, trials, snr, trial, own, estimators };
};

const imageLegend = () => [["truth", "truth"], ["found", "found: within the radius of the truth"], ["false", "false: farther away"], ["missed", "missed: a scatterer without a point"]];

const buildImages = (root) => {
  const panels = new CloudPanels(), projections = new Projections();
  const objects = h("details", {}, h("summary", {}, "Objects")), objectBox = h("div");
  objects.append(objectBox);
  const subject = selectControl("of", "Projections of", () => imageState().estimators.map((one) => [labelOf(one), labelOf(one)]));
  const legend = h("p", { class: "note" });
  root.append(
    controls(
      selectControl("scene", "Scene", imagedScenes, imagedScenes()[0]?.[0], () => ({ trial: "", hide: [] })),
      sliderControl("snr", "SNR", () => imageState().snrs, " dB", () => imageState().snr),
      sliderControl("trial", "Trial", () => imageState().trials, "", () => imageState().trial),
      buttonsControl("colour", "Colour", [["velocity", "velocity"], ["error", "error"], ["found", "found, missed, false"]], () => state.colour ?? "velocity"),
      checksControl("est", `Estimators, at most ${MOST_SHOWN}`, () => imageState().own.map((one) => [labelOf(one), labelOf(one), colourOf(data.estimators[one])]), () => imageState().estimators.map(labelOf), MOST_SHOWN),
      h("button", { type: "button", onclick: (event) => panels.look(START_EYE, event) }, "Reset the view"),
    ),
    objects,
    legend,
    panels.element,
    heading("Projections"),
    controls(subject),
    projections.element,
  );
  if (data.n_clouds_left_out)
    root.append(h("p", { class: "note" }, `${data.n_clouds_left_out} clouds are left out of this page to keep it small. It holds first what comparisons need, then the first trial of every scene and estimator at the SNR nearest ${data.shown_snr_db} dB, the image of largest deviation, the first trial at other SNRs, and further trials as they fit.`));
  let objectKey = null;
  return () => {
    const own = imageState(), images = own.estimators.map((one) => imageOf(own.scene, one, own.snr, own.trial));
    const { levels, codes } = objectsOf(own.scene);
    objects.hidden = !levels.length;
    const key = `${own.scene}|${state.hide.join("|")}`;
    if (key !== objectKey) {
      const check = (level, i) => {
        const input = h("input", { type: "checkbox", onchange: () => setState({ hide: input.checked ? state.hide.filter((one) => one !== level) : [...state.hide, level] }, true) });
        input.checked = !state.hide.includes(level);
        return h("label", {}, input, h("span", {}, `${short(level, 40)} (${codes.filter((code) => code === i).length})`));
      };
      objectBox.replaceChildren(h("div", { class: "tools" }, h("button", { type: "button", onclick: () => setState({ hide: [] }, true) }, "All on"), h("button", { type: "button", onclick: () => setState({ hide: [...levels] }, true) }, "All off")), h("div", { class: "choices", role: "group", "aria-label": "Objects" }, levels.map(check)));
      objectKey = key;
    }
    const radius = data.scenes[own.scene].radius_m;
    legend.replaceChildren(`Radius ${told(radius)} m. Drag or use the arrow keys to turn all clouds. `, ...((state.colour ?? "velocity") === "found" ? imageLegend().map(([name, text]) => h("span", {}, h("span", { class: "swatch", style: { background: css(name) } }), ` ${text}  `)) : [(state.colour ?? "velocity") === "velocity" ? "Diamonds are false points; grey: the truth." : "Grey: the truth."]));
    panels.draw(images);
    const focus = images.find((image) => labelOf(image.estimator) === state.of) ?? images[0];
    projections.draw(focus);
  };
};

/* Maps. */

const buildMaps = (root) => {
  const own = data.maps.maps, names = own.map((one) => [`${one.scene}|${one.estimator}`, `${one.scene}, ${one.estimator}`]);
  root.append(controls(selectControl("map", "Map of", names)));
  root.append(h("p", { class: "note" }, `Computed anew when this page was made, at ${own[0].snr_db} dB, trial ${own[0].trial}.${data.maps.left_out ? ` There was no time for ${counted(data.maps.left_out, "further scene")}; isacbench report DIR --scenario SCENARIO --snr DB draws one.` : ""}`));
  const figures = ["Power", "Threshold", "Power where detected"].map((title) => new Figure({ title, label: `${title} of the range-Doppler map`, height: 420 }));
  const spectra = h("div", { class: "grid" });
  root.append(h("div", { class: "grid" }, figures.map((figure) => figure.element)), heading("Angular spectra of the strongest cell"), spectra);
  return () => {
    const map = own.find((one) => `${one.scene}|${one.estimator}` === state.map) ?? own[0];
    const detected = map.power_db.map((row, i) => row.map((one, j) => (map.mask[i][j] ? one : null)));
    const all = map.power_db.flat(), low = Math.min(...all, ...map.threshold_db.flat()), high = Math.max(...all);
    [map.power_db, map.threshold_db, detected].forEach((z, i) => {
      const columns = [{ title: "range [m]", get: (row) => row[0] }, { title: "velocity [m/s]", get: (row) => row[1] }, { title: "dB over noise", get: (row) => row[2] }];
      const cells = map.range_m.flatMap((range, a) => map.velocity_mps.map((speed, b) => [range, speed, z[a][b]])).filter((row) => row[2] !== null);
      figures[i].table = () => dataTable({ caption: figures[i].heading.textContent, name: "map", columns, rows: cells, first: "dB over noise|down" });
      figures[i].note.textContent = `${short(map.scene)}, ${short(map.estimator)}${i === 2 ? `: ${counted(cells.length, "cell")} of ${all.length}` : ""}`;
      figures[i].draw([{ type: "heatmap", x: map.velocity_mps, y: map.range_m, z, zmin: low, zmax: high, colorscale: "Cividis", colorbar: { title: { text: "dB over noise", side: "right" }, thickness: 12, outlinewidth: 0 }, hovertemplate: "%{y} m, %{x} m/s: %{z} dB<extra></extra>" }], { xaxis: axis({ title: { text: "radial velocity [m/s]" } }), yaxis: axis({ title: { text: "range [m]" } }) });
    });
    const lines = map.spectra.map((one) => [one, new Figure({ title: `Spectrum along ${one.label}`, label: `Angular spectrum along ${one.label}`, height: 320, table: seriesTable(`Spectrum along ${one.label}`, one.label, "dB", [{ label: "level", x: one.cosine, y: one.level_db }]) })]);
    spectra.replaceChildren(...(lines.length ? lines.map(([, figure]) => figure.element) : ["Nothing was detected."]));
    for (const [one, figure] of lines) {
      const traces = [{ type: "scatter", mode: "lines", x: one.cosine, y: one.level_db, name: "spectrum", line: { color: css("found") } }];
      if (one.threshold_db) traces.push({ type: "scatter", mode: "lines", x: one.cosine, y: one.threshold_db, name: "threshold", line: { color: css("false"), dash: "dash" } });
      const at = (cosine) => one.level_db[one.cosine.reduce((best, other, i) => (Math.abs(other - cosine) < Math.abs(one.cosine[best] - cosine) ? i : best), 0)];
      traces.push({ type: "scatter", mode: "markers", x: one.peaks, y: one.peaks.map(at), name: "peaks", marker: { symbol: "triangle-down", size: 11, color: css("fg") } });
      figure.draw(traces, { xaxis: axis({ title: { text: `direction cosine ${one.label}` } }), yaxis: axis({ title: { text: "level [dB]" } }) });
    }
  };
};

/* Scenes as small pictures, the worst first. */

const thumbnail = (canvas, image) => {
  const { truth, cloud, pair, scene } = image, context = canvas.getContext("2d"), { width, height } = canvas;
  const [[left, right], [low, high]] = data.scenes[scene].region_m, scale = Math.min(width / (right - left || 1), height / (high - low || 1)) * 0.94;
  const place = (points, i) => [width / 2 + scale * (points.x[i] - (left + right) / 2), height / 2 - scale * (points.y[i] - (low + high) / 2)];
  const dots = (points, colour, size, test) => {
    context.fillStyle = colour;
    for (let i = 0; i < points.n; i++) {
      if (!test(i)) continue;
      const [x, y] = place(points, i);
      context.fillRect(x - size / 2, y - size / 2, size, size);
    }
  };
  dots(truth, css("truth"), 2.4, () => true);
  if (!cloud) return;
  const radius = data.scenes[scene].radius_m, missed = (i) => !(pair.ofTruth.distance[i] <= radius);
  dots(cloud, css("found"), 3, (i) => pair.ofCloud.distance[i] <= radius);
  dots(truth, css("missed"), 3, missed);
  dots(cloud, css("false"), 5, (i) => pair.ofCloud.distance[i] > radius);
};

const buildScenes = (root) => {
  const count = h("p", { class: "note" }), tiles = h("ul", { class: "tiles" });
  const names = () => data.estimators.map((own) => [own.label, own.label]);
  const best = () => (Object.values(data.ranks).find((one) => one.ranks)?.ranks[0]?.estimator ?? 0);
  const ordering = () => (metricOf("ratio").name === "ratio" ? "ratio" : data.metric);
  root.append(controls(familyControl(), selectControl("one", "Estimator", names, labelOf(best())), snrControl(), selectControl("by", "Worst first by", metricOptions, ordering())), count, tiles);
  return () => {
    const estimator = Math.max(data.estimators.findIndex((own) => own.label === (state.one ?? labelOf(best()))), 0);
    const metric = metricOf(state.by ?? ordering());
    const rows = filteredRows(["family", "snr"]).filter((row) => data.rows.estimator[row] === estimator);
    const listed = [...grouped(rows, (row) => data.rows.scene[row])].map(([scene, own]) => {
      const scores = valuesOf(own, metric.name), snr = state.snr ? Number(state.snr) : [...own].sort((a, b) => Math.abs(value("snr_db", a) - data.shown_snr_db) - Math.abs(value("snr_db", b) - data.shown_snr_db)).map((row) => value("snr_db", row))[0];
      const at = own.filter((row) => value("snr_db", row) === snr), row = at.find((one) => data.rows.cloud[one] >= 0) ?? at[0] ?? own[0];
      return { scene, row, failed: own.filter((one) => !isScored(one)).length, score: scores.length ? scores.reduce((sum, one) => sum + one, 0) / scores.length : null };
    });
    const sign = metric.better === "higher" ? 1 : -1;
    listed.sort((a, b) => (a.score === null) - (b.score === null) || sign * (a.score - b.score));
    count.textContent = `${counted(listed.length, "scene")}; mean ${metric.name} over ${state.snr ? `${state.snr} dB` : "all SNRs"}. Seen from above: grey truth, blue found, orange false, purple missed. A scene opens its image.`;
    tiles.replaceChildren(
      ...listed.map(({ scene, row, score, failed }) => {
        const own = data.scenes[scene], canvas = h("canvas", { width: 260, height: 180, "aria-hidden": "true" });
        if (own.truth.length) thumbnail(canvas, imageOf(scene, estimator, value("snr_db", row), value("trial", row)));
        const frame = own.frame ? `${own.frame}${own.coherent_phase ? ", coherent" : ""}` : "";
        return h("li", {}, h("a", { href: linkTo("images", { scene: own.name, snr: value("snr_db", row), trial: value("trial", row), est: [labelOf(estimator)], family: "" }) }, canvas, short(own.name, 60), h("br"), h("strong", {}, `${metric.name} ${score === null ? "none" : told(score)}`), failed ? h("span", { class: "bad" }, ` ${failed} failed`) : null, frame ? h("span", { class: "band" }, ` ${frame}`) : null));
      }),
    );
  };
};

/* Time against error. */

const buildTime = (root) => {
  const { points, stages } = data.times;
  const names = unique(points.map((point) => point.scenario));
  const figure = new Figure({ title: "Run time against error", label: "Median time over mean deviation, with intervals", height: 470, onClick: (point) => setState({ bar: point.customdata }, true) });
  const bars = new Figure({ title: "Stages of an estimate", label: "Time of each stage", height: 360 });
  const point = selectControl("bar", "Stages of", () => [["", "all estimators"], ...data.estimators.map((own) => [own.label, own.label])]);
  root.append(controls(selectControl("scene", "Scene", names.map((name) => [name, name])), snrControl()), figure.element, h("div", { class: "controls below" }, point), bars.element);
  return () => {
    const scene = names.includes(state.scene) ? state.scene : names[0];
    const snrs = unique(points.filter((one) => one.scenario === scene).map((one) => one.snr_db));
    const snr = state.snr ? Number(state.snr) : snrs.reduce((best, one) => (Math.abs(one - data.shown_snr_db) < Math.abs(best - data.shown_snr_db) ? one : best), snrs[0]);
    const own = points.filter((one) => one.scenario === scene && one.snr_db === snr);
    const number = (one) => data.estimators.findIndex((other) => other.name === one.estimator && other.params === one.params);
    figure.heading.textContent = `Run time against error: ${short(scene)}, ${snr} dB`;
    figure.note.textContent = "Left and low is better. Rings are on the frontier: no other estimator is better in both. Bars are 95 % intervals. A click on a point shows its stages.";
    figure.table = () => dataTable({ caption: figure.heading.textContent, name: `times ${scene} ${snr}`, columns: [{ title: "estimator", isText: true, get: (one) => one.label }, ...["time_s", "time_low_s", "time_high_s", "deviation_mean", "deviation_low", "deviation_high", "peak_memory_mib", "n_trials", "n_failed"].map((name) => ({ title: name, get: (one) => one[name] })), { title: "frontier", isText: true, get: (one) => (one.is_on_frontier ? "yes" : "") }], rows: own });
    const apart = (mid, end) => own.map((one) => (one[end] === null ? 0 : Math.abs(one[end] - one[mid])));
    const traces = own.map((one, i) => {
      const look = data.estimators[number(one)], colour = colourOf(look);
      const error = (mid, low, high) => ({ type: "data", symmetric: false, array: [apart(mid, high)[i]], arrayminus: [apart(mid, low)[i]], color: colour, thickness: 1.5 });
      return { type: "scatter", mode: "markers+text", x: [one.time_s], y: [one.deviation_mean], text: [plain(one.label, 28)], textposition: "top right", customdata: [one.label], marker: { size: one.is_on_frontier ? 13 : 9, color: colour, symbol: look.symbol || "cross", line: { width: one.is_on_frontier ? 2.5 : 0, color: css("fg") } }, error_x: error("time_s", "time_low_s", "time_high_s"), error_y: error("deviation_mean", "deviation_low", "deviation_high"), hovertemplate: "%{text}: %{x:.3g} s, %{y:.3g}<extra></extra>", showlegend: false };
    });
    figure.draw(traces, { xaxis: axis(axisNote("time of an estimate [s]", true)), yaxis: axis({ title: { text: "imaging deviation" }, rangemode: "tozero" }) });
    const names2 = unique(stages.flatMap((one) => Object.keys(one))).filter((name) => /^time_(?!estimate|spread).*_s_median$/.test(name));
    const shown = stages.filter((one) => one.scenario === scene && one.snr_db === snr && (!state.bar || labelOf(number(one)) === state.bar));
    const used = names2.filter((name) => shown.some((one) => one[name]));
    const title = (name) => name.replace(/^time_|_s_median$/g, "");
    const palette = ["#0072B2", "#E69F00", "#009E73", "#CC79A7", "#D55E00", "#56B4E9", "#999999", "#F0E442"];
    bars.table = () => dataTable({ caption: "Median time of each stage [ms]", name: "stages", columns: [{ title: "estimator", isText: true, get: (one) => labelOf(number(one)) }, ...used.map((name) => ({ title: title(name), get: (one) => 1e3 * one[name] }))], rows: shown });
    bars.draw(used.map((name, i) => ({ type: "bar", orientation: "h", name: title(name), y: shown.map((one) => plain(labelOf(number(one)))), x: shown.map((one) => 1e3 * one[name]), marker: { color: palette[i % palette.length], pattern: { shape: ["", "/", "\\", "x", ".", "-", "|", "+"][i % 8], fillmode: "overlay", fgcolor: "rgba(0,0,0,0.45)", size: 6 } } })), { barmode: "stack", xaxis: axis({ title: { text: "median time [ms]" } }), yaxis: axis({ automargin: true, autorange: "reversed" }) });
  };
};

/* Studies: bit errors, false-alarm rates, resolution, efficiency. */

const STUDIES = { link: "Link", detection: "Detectors", resolution: "Resolution", efficiency: "Efficiency" };
const buildStudy = (root) => {
  const found = [];
  for (const [group, charts] of grouped(data.charts, (chart) => chart.group)) {
    const grid = h("div", { class: "grid" });
    root.append(heading(short(group, 120)), grid);
    for (const chart of charts) {
      const figure = new Figure({ title: chart.title, label: `${chart.y.title} over ${chart.x.title}`, height: 400, table: seriesTable(chart.title, chart.x.title, chart.y.title, chart.series) });
      grid.append(figure.element);
      found.push([chart, figure]);
    }
  }
  return () => {
    for (const [chart, figure] of found) {
      const traces = chart.series.flatMap((series) => lineWithBand(series, series, chart.y.log));
      const shapes = chart.line === null ? [] : [{ type: "line", xref: "paper", x0: 0, x1: 1, y0: chart.line, y1: chart.line, line: { color: css("fg"), dash: "dash", width: 1.5 } }];
      const heights = [...chart.series.flatMap((series) => [...series.y, ...series.low, ...series.high]), chart.line].filter((one) => one > 0);
      const decades = chart.y.log && heights.length ? [Math.floor(Math.log10(Math.min(...heights))), Math.ceil(Math.log10(Math.max(...heights)))] : null;
      const range = chart.y.range ?? decades;
      figure.draw(traces, { shapes, xaxis: axis(axisNote(chart.x.title, chart.x.log)), yaxis: axis({ ...axisNote(chart.y.title, chart.y.log), ...(range ? { range } : {}) }), hovermode: "closest" });
    }
  };
};

/* Comparison: regressions first, each with both images at its worst cell. */

const buildComparison = (root) => {
  const own = data.comparison, panels = new CloudPanels(), said = h("h2", { tabindex: -1 });
  const table = h("div"), note = h("p", { class: "note" });
  root.append(h("p", { class: own.is_regression ? "bad" : null }, own.summary), h("p", { class: "note" }, own.heading.join("; ")));
  root.append(controls(selectControl("what", "Show", [["", "curves, and points that changed"], ["curve", "curves"], ["regression", "regressions"], ["improvement", "improvements"]])), table, said, note, panels.element);
  for (const line of own.lines) root.append(h("p", { class: "note" }, line));
  for (const { what, cells, n } of own.lost)
    root.append(heading(`${counted(n, "cell")} ${what}`), dataTable({ caption: `Cells ${what}; at most 50 are listed`, name: what, columns: ["scenario", "estimator", "snr_db", "trial", "status", "reason"].map((name) => ({ title: name, isText: ["scenario", "estimator", "status", "reason"].includes(name), get: (row) => row[name] })), rows: cells }));
  const names = (row) => unique([row.base, row.new].filter((one) => one !== null).map(labelOf)).join(" → ");
  const change = (row) => [told(row.change), h("span", { class: "band" }, row.change_low === null ? "" : ` (${told(row.change_low)} to ${told(row.change_high)})`)];
  return () => {
    const rows = own.rows.map((row, i) => ({ ...row, i })).filter((row) => !state.what || row.what === state.what || row.verdict === state.what);
    const columns = [
      { title: "verdict", isText: true, get: (row) => row.verdict, show: (row) => h("span", { class: row.verdict }, row.verdict) },
      { title: "score", isText: true, get: (row) => row.metric },
      { title: "estimators", isText: true, get: names },
      { title: "scene", isText: true, get: (row) => row.scenario },
      { title: "SNR [dB]", get: (row) => row.snr_db ?? null, show: (row) => (row.snr_db === null || row.snr_db === undefined ? "all" : told(row.snr_db)) },
      { title: "pairs", get: (row) => row.n_pairs },
      { title: own.sides[0], csv: "base", get: (row) => row.base_mean },
      { title: own.sides[1], csv: "new", get: (row) => row.new_mean },
      { title: "change", about: "95 % bootstrap interval", get: (row) => row.change, show: change },
      { title: "p worse", get: (row) => row.p_worse },
      { title: "worst cell", isText: true, get: (row) => (row.worst ? `${row.worst.scene}, ${row.worst.snr_db} dB, trial ${row.worst.trial}` : ""), show: (row) => (row.worst ? h("button", { type: "button", onclick: () => (setState({ row: String(row.i) }, true), said.focus()) }, `Images: ${short(row.worst.scene, 30)}, ${row.worst.snr_db} dB, trial ${row.worst.trial}`) : "") },
    ];
    table.replaceChildren(dataTable({ caption: `${own.tolerances.map((one) => one.text).join(", ")}; the ${own.unit} is the unit`, name: "comparison", columns, rows }));
    const row = own.rows[Number(state.row ?? own.rows.findIndex((one) => one.worst))];
    panels.element.hidden = !row?.worst;
    if (!row?.worst) return said.replaceChildren("No images to compare");
    const scene = data.sceneNumber.get(row.worst.scene);
    said.replaceChildren(`${row.verdict}: ${row.metric}, ${short(names(row))} on ${short(row.worst.scene)}, ${row.worst.snr_db} dB, trial ${row.worst.trial}`);
    note.replaceChildren("The cell in which the score got worse most. ", h("a", { href: linkTo("images", { scene: row.worst.scene, snr: row.worst.snr_db, trial: row.worst.trial, est: unique([row.base, row.new]).map(labelOf) }) }, "Open it among the images"), ".");
    if (!data.scenes[scene]?.truth.length) return panels.element.replaceChildren("The truth of this scene is not stored.");
    panels.draw([row.base, row.new].map((one) => imageOf(scene, one, row.worst.snr_db, row.worst.trial)));
  };
};

/* All rows. */

const buildRows = (root) => {
  const box = h("div");
  const statuses = () => [["", "any status"], ...unique(rowsWhere(() => true).map((row) => value("status", row))).map((one) => [one, one])];
  root.append(controls(familyControl(), sceneControl(), snrControl(), selectControl("status", "Status", statuses), checksControl("est", "Estimators", estimatorOptions, () => (state.est.length ? state.est : data.estimators.map((own) => own.label)))), box);
  return () => {
    const rows = filteredRows(["family", "scene", "snr", "est", "status"]);
    const rest = Object.keys(data.rows).filter((name) => !["estimator", "scene", "snr_db", "trial", "status", "cloud", "has_image"].includes(name) && !name.endsWith("_spread"));
    const columns = [...cellColumns(), ...rest.map((name) => ({ title: name, isText: !Array.isArray(data.rows[name]), get: (row) => value(name, row) }))];
    box.replaceChildren(dataTable({ caption: `${rows.length} of ${data.n} rows`, name: "rows", columns, rows, sortKey: "sort" }));
  };
};

const views = {
  comparison: { title: () => "Comparison", isAvailable: () => Boolean(data.comparison), build: buildComparison },
  overview: {
    title: () => "Overview",
    isAvailable: () => true,
    build: (root) => {
      const box = h("div");
      root.append(factsOf(), controls(familyControl(), sceneControl(), snrControl(), metricControl()), box, ...factTables(), parameterTable());
      return () => drawOverview(box);
    },
  },
  curves: { title: () => "Curves", isAvailable: () => data.metrics.length > 0, build: buildCurves },
  images: { title: () => "Images", isAvailable: () => data.scenes.some((scene) => scene.truth.length), build: buildImages },
  maps: { title: () => "Maps", isAvailable: () => Boolean(data.maps?.maps?.length), build: buildMaps },
  scenes: { title: () => "Scenes", isAvailable: () => data.scenes.filter((scene) => scene.truth.length).length > 1, build: buildScenes },
  time: { title: () => "Time against error", isAvailable: () => Boolean(data.times.points), build: buildTime },
  study: { title: () => STUDIES[data.suite_kind] ?? "Study", isAvailable: () => data.charts.length > 0, build: buildStudy },
  rows: { title: () => "Rows", isAvailable: hasTrials, build: buildRows },
};
