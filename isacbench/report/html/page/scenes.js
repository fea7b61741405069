/* Scenes as small pictures, the worst first. */

const thumbnail = (canvas, image) => {
  const { truth, cloud, pair, scene } = image,
    context = canvas.getContext("2d"),
    { width, height } = canvas;
  const [[left, right], [low, high]] = data.scenes[scene].region_m,
    scale = Math.min(width / (right - left || 1), height / (high - low || 1)) * 0.94;
  const place = (points, i) => [
    width / 2 + scale * (points.x[i] - (left + right) / 2),
    height / 2 - scale * (points.y[i] - (low + high) / 2),
  ];
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
  const radius = data.scenes[scene].radius_m,
    missed = (i) => !(pair.ofTruth.distance[i] <= radius);
  dots(cloud, css("found"), 3, (i) => pair.ofCloud.distance[i] <= radius);
  dots(truth, css("missed"), 3, missed);
  dots(cloud, css("false"), 5, (i) => pair.ofCloud.distance[i] > radius);
};

const buildScenes = (root) => {
  const count = h("p", { class: "note" }),
    tiles = h("ul", { class: "tiles" });
  const names = () => data.estimators.map((own) => [own.label, own.label]);
  const best = () => Object.values(data.ranks).find((one) => one.ranks)?.ranks[0]?.estimator ?? 0;
  const ordering = () => (metricOf("ratio").name === "ratio" ? "ratio" : data.metric);
  root.append(
    controls(
      familyControl(),
      selectControl("one", "Estimator", names, labelOf(best())),
      snrControl(),
      selectControl("by", "Worst first by", () => metricOptions().filter(([name]) => metricOf(name).better !== "neither"), ordering()),
    ),
    count,
    tiles,
  );
  return () => {
    const label = state.one ?? labelOf(best()),
      estimator = Math.max(data.estimators.map((own) => own.label).indexOf(label), 0);
    const metric = metricOf(state.by ?? ordering());
    const rows = filteredRows(["family", "snr"]).filter((row) => data.rows.estimator[row] === estimator);
    const listed = [...grouped(rows, (row) => data.rows.scene[row])].map(([scene, own]) => {
      const scores = valuesOf(own.filter(isScored), metric.name),
        snr = state.snr ? Number(state.snr) : nearTo(numbersOf("snr_db", own), data.shown_snr_db);
      const at = own.filter((row) => value("snr_db", row) === snr),
        row = at.find((one) => data.rows.cloud[one] >= 0) ?? at[0] ?? own[0];
      return { scene, row, failed: own.filter((one) => !isScored(one)).length, score: mean(scores) };
    });
    const sign = metric.better === "higher" ? 1 : -1;
    const last = (one) => (one.score !== null ? 1 : one.failed ? 0 : 2); // failed ones first, those without such a score last
    listed.sort((a, b) => last(a) - last(b) || sign * (a.score - b.score));
    count.textContent = `${counted(listed.length, "scene")}; mean ${metric.name} over ${state.snr ? `${state.snr} dB` : "all SNRs"}. Seen from above: grey truth, blue found, orange false, purple missed. A scene opens its image.`;
    tiles.replaceChildren(
      ...listed.map(({ scene, row, score, failed }) => {
        const own = data.scenes[scene],
          canvas = h("canvas", { width: 260, height: 180, "aria-hidden": "true" });
        if (own.truth.length) thumbnail(canvas, imageOf(scene, estimator, value("snr_db", row), value("trial", row)));
        const frame = own.frame ? `${own.frame}${own.coherent_phase ? ", coherent" : ""}` : "";
        return h(
          "li",
          {},
          h(
            "a",
            { href: imageAddress(own.name, value("snr_db", row), value("trial", row), [labelOf(estimator)]) },
            canvas,
            short(own.name, 60),
            h("br"),
            h("strong", {}, `${metric.name} ${score === null ? "none" : told(score)}`),
            failed ? h("span", { class: "bad" }, ` ${failed} failed`) : null,
            frame ? h("span", { class: "band" }, ` ${frame}`) : null,
          ),
        );
      }),
    );
  };
};
