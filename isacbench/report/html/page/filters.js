/* What several views share: rows that the filters let through, options and controls. */

const heading = (text) => h("h2", {}, text);
const note = (text) => h("p", { class: "note" }, text);
const numbersOf = (name, rows) => unique(rows.map((row) => value(name, row))).sort((a, b) => a - b);
const sceneOptions = () => data.scenes.map((scene) => [scene.name, scene.name]);
const imagedScenes = () => data.scenes.filter((scene) => scene.truth.length).map((scene) => [scene.name, scene.name]);
const families = () => unique(data.scenes.map((scene) => scene.family ?? "")).filter(Boolean);
const metricOptions = () => data.metrics.map((metric) => [metric.name, metric.title]);
const estimatorOptions = () => data.estimators.map((own) => [own.label, own.label, colourOf(own)]);
const estimatorNumbers = () => data.estimators.map((_, i) => i);
const ranked = () => state.metric ?? data.metric;
const chosenScene = () => (state.scene === EVERY ? "" : state.scene);

/* Rows that the filters of the state let through. */
const filteredRows = (names = ["family", "scene", "snr"]) =>
  rowsWhere(
    (row) =>
      (!names.includes("family") || !state.family || data.scenes[data.rows.scene[row]].family === state.family) &&
      (!names.includes("scene") || !chosenScene() || sceneName(row) === chosenScene()) &&
      (!names.includes("snr") || !state.snr || value("snr_db", row) === Number(state.snr)) &&
      (!names.includes("est") || !state.est.length || state.est.includes(labelOf(data.rows.estimator[row]))) &&
      (!names.includes("status") || !state.status || value("status", row) === state.status),
  );

const familyControl = () =>
  families().length > 1
    ? selectControl(
        "family",
        "Family",
        () => [["", "all families"], ...families().map((one) => [one, one])],
        "",
        () => ({ scene: "" }),
      )
    : null;
const sceneControl = () =>
  data.scenes.length > 1
    ? selectControl("scene", "Scene", () => [
        ["", `all ${data.scenes.length} scenes`],
        ...sceneOptions().filter(([name]) => !state.family || data.scenes[data.sceneNumber.get(name)].family === state.family),
      ])
    : null;
const chosenEstimators = () => (state.est.length ? state.est : data.estimators.map((own) => own.label));
const estimatorsControl = () => checksControl("est", "Estimators", estimatorOptions, chosenEstimators);
const snrControl = () => selectControl("snr", "SNR", () => [["", "all SNRs"], ...data.snrs.map((snr) => [snr, `${told(snr, 6)} dB`])]);
const metricControl = () => selectControl("metric", "Metric", metricOptions, data.metric);
const controls = (...own) => h("div", { class: "controls", role: "group", "aria-label": "Choices" }, own);
