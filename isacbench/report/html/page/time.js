/* Time against error. */

const buildTime = (root) => {
  const { points, stages } = data.times;
  const names = unique(points.map((point) => point.scenario));
  const sceneOf = () => (names.includes(state.scene) ? state.scene : names[0]);
  /* SNRs of the scene, the one first that is shown where none is chosen. */
  const snrsOf = () => {
    const found = unique(points.filter((one) => one.scenario === sceneOf()).map((one) => one.snr_db));
    return found.sort((a, b) => Math.abs(a - data.shown_snr_db) - Math.abs(b - data.shown_snr_db));
  };
  const figure = new Figure({
    title: "Run time against error",
    label: "Median time over mean Hausdorff sum, with intervals",
    height: 470,
    onClick: (point) => setState({ bar: point.customdata }, true),
  });
  const bars = new Figure({ title: "Stages of an estimate", label: "Time of each stage", height: 360 });
  const sceneNames = names.map((name) => [name, name]);
  const snrOptions = () => snrsOf().map((snr) => [snr, `${told(snr, 6)} dB`]);
  const point = selectControl("bar", "Stages of", () => [["", "all estimators"], ...data.estimators.map((own) => [own.label, own.label])]);
  root.append(
    controls(selectControl("scene", "Scene", sceneNames), selectControl("snr", "SNR", snrOptions)),
    figure.element,
    h("div", { class: "controls below" }, point),
    bars.element,
  );
  return () => {
    const scene = sceneOf(),
      snrs = snrsOf(),
      snr = snrs.includes(Number(state.snr)) && state.snr ? Number(state.snr) : snrs[0];
    const own = points.filter((one) => one.scenario === scene && one.snr_db === snr);
    const number = (one) => data.estimators.findIndex((other) => other.name === one.estimator && other.params === one.params);
    figure.heading.textContent = `Run time against error: ${short(scene)}, ${snr} dB`;
    figure.note.textContent =
      "Left and low is better. Rings are on the frontier: no other estimator is better in both. Bars are 95 % intervals. A click on a point shows its stages.";
    figure.table = () =>
      dataTable({
        caption: figure.heading.textContent,
        name: `times ${scene} ${snr}`,
        columns: [
          { title: "estimator", isText: true, get: (one) => one.label },
          ...Object.entries({
            time_s: "median time [s]",
            time_low_s: "time from [s]",
            time_high_s: "time to [s]",
            hausdorff_sum_m_mean: "mean Hausdorff sum [m]",
            hausdorff_sum_m_low: "sum from [m]",
            hausdorff_sum_m_high: "sum to [m]",
            peak_memory_mib: "peak memory [MiB]",
            n_trials: "trials",
            n_failed: "failed",
          }).map(([name, title]) => ({ title, csv: name, get: (one) => one[name] })),
          { title: "frontier", isText: true, get: (one) => (one.is_on_frontier ? "yes" : "") },
        ],
        rows: own,
      });
    const apart = (one, mid, end, scale) => (one[end] === null ? 0 : scale * Math.abs(one[end] - one[mid]));
    const traces = own.map((one) => {
      const look = data.estimators[number(one)],
        colour = colourOf(look);
      const error = (mid, low, high, scale = 1) => ({
        type: "data",
        symmetric: false,
        array: [apart(one, mid, high, scale)],
        arrayminus: [apart(one, mid, low, scale)],
        color: colour,
        thickness: 1.5,
      });
      return {
        type: "scatter",
        mode: "markers+text",
        x: [1e3 * one.time_s],
        y: [one.hausdorff_sum_m_mean],
        text: [plain(one.label, 28)],
        textposition: "top right",
        customdata: [one.label],
        marker: {
          size: one.is_on_frontier ? 13 : 9,
          color: colour,
          symbol: look.symbol || "cross",
          line: { width: one.is_on_frontier ? 2.5 : 0, color: css("fg") },
        },
        error_x: error("time_s", "time_low_s", "time_high_s", 1e3),
        error_y: error("hausdorff_sum_m_mean", "hausdorff_sum_m_low", "hausdorff_sum_m_high"),
        hovertemplate: "%{text}: %{x:.3g} ms, %{y:.3g} m<extra></extra>",
        showlegend: false,
      };
    });
    figure.draw(traces, {
      xaxis: axis(axisNote("median processor time of an image [ms]", true)),
      yaxis: axis({ title: { text: "Hausdorff sum [m]" }, rangemode: "tozero" }),
    });
    const names2 = unique(stages.flatMap((one) => Object.keys(one))).filter((name) => /^time_(?!estimate|spread).*_s_median$/.test(name));
    const shown = stages.filter(
      (one) => one.scenario === scene && one.snr_db === snr && (!state.bar || labelOf(number(one)) === state.bar),
    );
    const used = names2.filter((name) => shown.some((one) => one[name]));
    const title = (name) => name.replace(/^time_|_s_median$/g, "");
    bars.table = () =>
      dataTable({
        caption: "Median time of each stage [ms]",
        name: "stages",
        columns: [
          { title: "estimator", isText: true, get: (one) => labelOf(number(one)) },
          ...used.map((name) => ({ title: title(name), get: (one) => 1e3 * one[name] })),
        ],
        rows: shown,
      });
    bars.draw(
      used.map((name, i) => ({
        type: "bar",
        orientation: "h",
        name: title(name),
        y: shown.map((_, i) => i),
        x: shown.map((one) => 1e3 * one[name]),
        marker: { color: data.times.stage_colours[name] },
      })),
      {
        barmode: "stack",
        xaxis: axis({ title: { text: "median processor time [ms]" } }),
        yaxis: axis({
          autorange: "reversed",
          tickvals: shown.map((_, i) => i),
          ticktext: shown.map((one) => plain(labelOf(number(one)))),
        }),
      },
    );
  };
};
