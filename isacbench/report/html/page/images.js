/* Images. */

const imageState = () => {
  const imaged = data.scenes.findIndex((scene) => scene.name === state.scene && scene.truth.length);
  const scene = imaged >= 0 ? imaged : data.scenes.findIndex((one) => one.truth.length);
  const rows = rowsWhere((row) => data.rows.scene[row] === scene);
  const snrs = numbersOf("snr_db", rows),
    trials = numbersOf("trial", rows);
  const snr = nearTo(snrs, state.snr ? Number(state.snr) : data.shown_snr_db),
    trial = nearTo(trials, Number(state.trial ?? trials[0]));
  const own = unique(rows.map((row) => data.rows.estimator[row]));
  const wanted = own.filter((one) => state.est.includes(labelOf(one)));
  const ofEstimator = (one) => rows.filter((row) => data.rows.estimator[row] === one);
  const score = (one) => mean(valuesOf(ofEstimator(one), "deviation")) ?? Infinity;
  const best = own.filter((one) => !data.estimators[one].is_reference).sort((a, b) => score(a) - score(b));
  const estimators = (wanted.length ? wanted : (best.length ? best : own).slice(0, 2)).slice(0, MOST_SHOWN);
  return { scene, snrs, trials, snr, trial, own, estimators };
};

const imageLegend = () => [
  ["truth", "truth"],
  ["found", "found: within the radius of the truth"],
  ["false", "false: farther away"],
  ["missed", "missed: a scatterer without a point"],
];

const COLOURINGS = [
  ["velocity", "velocity"],
  ["error", "error"],
  ["found", "found, missed, false"],
];

const buildImages = (root) => {
  const slider = (key, label, values, unit) => {
    const valuesOfState = () => imageState()[values];
    return sliderControl(key, label, valuesOfState, unit, () => imageState()[key]);
  };
  const panels = new CloudPanels(),
    projections = new Projections();
  const objects = h("details", {}, h("summary", {}, "Objects")),
    objectBox = h("div");
  objects.append(objectBox);
  const subject = selectControl("of", "Projections of", () => imageState().estimators.map((one) => [labelOf(one), labelOf(one)]));
  const legend = h("p", { class: "note" });
  root.append(
    controls(
      selectControl("scene", "Scene", imagedScenes, imagedScenes()[0]?.[0], () => ({ family: "", hide: [] })),
      slider("snr", "SNR", "snrs", " dB"),
      slider("trial", "Trial", "trials", ""),
      buttonsControl("colour", "Colour", COLOURINGS, () => state.colour ?? "velocity"),
      checksControl(
        "est",
        `Estimators, at most ${MOST_SHOWN}`,
        () => imageState().own.map((one) => [labelOf(one), labelOf(one), colourOf(data.estimators[one])]),
        () => imageState().estimators.map(labelOf),
        MOST_SHOWN,
      ),
      h("button", { type: "button", onclick: (event) => panels.look({ eye: START_EYE, center: CENTRE }, event) }, "Reset the view"),
    ),
    objects,
    legend,
    panels.element,
    heading("Projections"),
    controls(subject),
    projections.element,
  );
  if (data.n_clouds_left_out)
    root.append(
      note(
        `${data.n_clouds_left_out} clouds are left out of this page to keep it small. It holds first what comparisons need, then the first trial of every scene and estimator at the SNR nearest ${data.shown_snr_db} dB, the image of largest deviation, the first trial at other SNRs, and further trials as they fit.`,
      ),
    );
  let objectKey = null;
  return () => {
    const own = imageState(),
      images = own.estimators.map((one) => imageOf(own.scene, one, own.snr, own.trial));
    const { levels, codes } = objectsOf(own.scene);
    objects.hidden = !levels.length;
    const key = `${own.scene}|${state.hide.join("|")}`;
    if (key !== objectKey) {
      const check = (level, i) => {
        const input = h("input", {
          type: "checkbox",
          "data-key": `object ${level}`,
          onchange: () => setState({ hide: input.checked ? state.hide.filter((one) => one !== level) : [...state.hide, level] }, true),
        });
        input.checked = !state.hide.includes(level);
        return h("label", {}, input, h("span", {}, `${short(level, 40)} (${codes.filter((code) => code === i).length})`));
      };
      objectBox.replaceChildren(
        h(
          "div",
          { class: "tools" },
          h("button", { type: "button", onclick: () => setState({ hide: [] }, true) }, "All on"),
          h("button", { type: "button", onclick: () => setState({ hide: [...levels] }, true) }, "All off"),
        ),
        h("div", { class: "choices", role: "group", "aria-label": "Objects" }, levels.map(check)),
      );
      objectKey = key;
    }
    const radius = data.scenes[own.scene].radius_m;
    legend.replaceChildren(
      `Radius ${told(radius)} m. Drag or use the arrow keys to turn all clouds. `,
      ...((state.colour ?? "velocity") === "found"
        ? imageLegend().map(([name, text]) => h("span", {}, h("span", { class: "swatch", style: { background: css(name) } }), ` ${text}  `))
        : [(state.colour ?? "velocity") === "velocity" ? "Diamonds are false points; grey: the truth." : "Grey: the truth."]),
    );
    panels.draw(images);
    const focus = images.find((image) => labelOf(image.estimator) === state.of) ?? images[0];
    projections.draw(focus);
  };
};
