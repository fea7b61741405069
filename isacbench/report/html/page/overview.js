/* Overview: facts, estimators ranked, failures. */

const factsOf = () => {
  const failed = rowsWhere((row) => !isScored(row)).length;
  const facts = data.runs[0].facts;
  const listed = [
    ["scenes", data.scenes.length],
    ["estimators", data.estimators.length],
    ["SNRs", data.snrs.length],
    ["cells", data.n],
    ["failed", failed],
    ["suite", facts.suite],
    ["isacbench", facts.isacbench],
    ["started", facts.started.slice(0, 16).replace("T", " ")],
  ];
  if (data.runs.some((run) => run.facts.interrupted)) listed.push(["interrupted", "yes"]);
  return h(
    "dl",
    { class: "facts" },
    listed.map(([name, own]) =>
      h("div", {}, h("dt", {}, name), h("dd", { class: (name === "failed" && own) || name === "interrupted" ? "bad" : null }, String(own))),
    ),
  );
};

const rankGroup = () => (chosenScene() || state.snr ? null : state.family ? `${state.family} scenes` : "all scenes");
const rankRows = (metric) => {
  const ranking = data.ranks[metric],
    group = rankGroup();
  return ranking?.ranks && group ? ranking.ranks.filter((row) => row.group === group) : [];
};
const rankText = (row) =>
  !row || row.rank_low === null ? "" : row.rank_low === row.rank_high ? `${row.rank_low}` : `${row.rank_low} to ${row.rank_high}`;

const drawOverview = (box) => {
  const rows = filteredRows(),
    scenes = unique(rows.map((row) => data.rows.scene[row])),
    overScenes = scenes.length >= 6;
  const byEstimator = grouped(rows, (row) => data.rows.estimator[row]),
    metric = metricOf(ranked()),
    sets = rankRows(metric.name);
  const listed = estimatorNumbers()
    .filter((one) => byEstimator.has(one))
    .map((one) => {
      const own = byEstimator.get(one);
      return {
        estimator: one,
        rows: own,
        failed: own.filter((row) => !isScored(row)).length,
        set: sets.find((row) => row.estimator === one),
        of: Object.fromEntries(data.metrics.map((each) => [each.name, summary(own, each, overScenes)])),
      };
    });
  const sign = metric.better === "higher" ? "down" : "up";
  const beside = ["ratio", "hausdorff_sum_m", "f_score", "objects_f_score", "velocity_error_mps", "deviation", "time_estimate_s"];
  const shown = data.metrics
    .filter((each) => each.name === metric.name || beside.includes(each.name))
    .sort((a, b) => (b.name === metric.name) - (a.name === metric.name));
  const columns = [
    estimatorColumn((row) => row.estimator),
    data.runs.length > 1 ? { title: "run", isText: true, get: (row) => data.runs[data.estimators[row.estimator].run].name } : null,
    sets.length
      ? {
          title: "rank",
          about: `Set of ranks by ${metric.title}, simultaneous 95 % confidence`,
          get: (row) => row.set?.rank_low ?? null,
          show: (row) => (row.set?.is_reference ? "reference" : rankText(row.set)),
        }
      : null,
    ...shown.flatMap((each) => [
      {
        title: each.axis,
        about: `${each.title}, ${each.better} is better`,
        get: (row) => row.of[each.name].mean,
        show: (row) => withBand(row.of[each.name]),
      },
      { title: `${each.axis} ±`, isHidden: true, get: (row) => row.of[each.name].band },
    ]),
    {
      title: "failed",
      get: (row) => row.failed,
      show: (row) => (row.failed ? h("span", { class: "bad" }, `${row.failed} of ${row.rows.length}`) : "0"),
    },
    { title: "cells", get: (row) => row.rows.length },
  ].filter(Boolean);
  const where = [
    chosenScene() || (state.family ? `${state.family} scenes` : counted(scenes.length, "scene")),
    state.snr ? `${state.snr} dB` : "all SNRs",
  ].join(", ");
  const unit = overScenes ? "means over scenes ± 95 % interval over scenes" : "means over trials ± 95 % interval over trials";
  const table = dataTable({
    caption: `${where}; ${unit}${!overScenes && listed.some((row) => data.estimators[row.estimator].is_reference) ? "; ± of references: spread over realisations" : ""}`,
    name: `estimators ${where}`,
    columns,
    rows: listed,
    sortKey: "sort",
    first: `${metric.axis}|${sign}`,
    rowClass: (row) => (data.estimators[row.estimator].is_reference ? "reference" : null),
  });
  const order = [...listed]
    .filter((row) => row.of[metric.name].mean !== null)
    .sort((a, b) => (metric.better === "higher" ? 1 : -1) * (a.of[metric.name].mean - b.of[metric.name].mean));
  const parts = [...data.notes.map(note), table];
  const reason = data.ranks[metric.name]?.reason ?? Object.values(data.ranks).find((one) => one.reason)?.reason;
  if (!sets.length)
    parts.push(
      note(
        data.ranks[metric.name]?.ranks
          ? "Rank sets are over all SNRs, and over all scenes or families of 20 scenes or more."
          : `No rank sets: ${reason ? short(reason, 600) : "they are made of the ratio, the Hausdorff sum, the F-scores of points and objects, the deviation, and of the metric of isacbench rank"}`,
      ),
    );
  parts.push(...(data.ranks[metric.name]?.notes ?? []).map(note));
  const figure = new Figure({
    title: `${metric.title}: ${where}`,
    label: `${metric.title} of each estimator with its interval`,
    height: 90 + 30 * order.length,
    table: () =>
      dataTable({
        caption: metric.title,
        name: metric.name,
        columns: columns.filter((column) => ["estimator", metric.axis].includes(column.title)),
        rows: order,
      }),
  });
  parts.push(figure.element);
  box.replaceChildren(...parts, ...winTable(metric.name), ...worstTable(metric.name), failureTable(rows));
  figure.draw(
    order.map((row) => {
      const look = data.estimators[row.estimator],
        own = row.of[metric.name],
        colour = colourOf(look);
      return {
        type: "scatter",
        mode: "markers",
        x: [own.mean],
        y: [order.indexOf(row)],
        name: plain(look.label),
        marker: { size: 10, color: colour, symbol: look.symbol || "line-ns-open" },
        error_x: { type: "data", array: [own.band ?? 0], color: colour, thickness: 2 },
        hovertemplate: "%{x:.4g}<extra></extra>",
        showlegend: false,
      };
    }),
    {
      xaxis: axis({ ...axisNote(metric.axis, false), rangemode: "tozero" }),
      yaxis: axis({
        tickvals: order.map((_, i) => i),
        ticktext: order.map((row) => plain(labelOf(row.estimator))),
        zeroline: false,
      }),
      margin: { l: 30, r: 20, t: 8, b: 45 },
    },
  );
};

const winTable = (metric) => {
  const ranking = data.ranks[metric],
    group = rankGroup();
  const wins = ranking?.wins && group ? ranking.wins.filter((row) => row.group === group) : [];
  if (!wins.length) return [];
  const numbers = unique(wins.map((row) => row.estimator));
  const find = (one, other) => wins.find((row) => row.estimator === one && row.other === other);
  const columns = [estimatorColumn((one) => one, "better")];
  for (const other of numbers)
    columns.push({
      title: labelOf(other),
      get: (one) => find(one, other)?.probability ?? null,
      show: (one) => {
        const own = find(one, other);
        return own ? [told(own.probability, 2), h("span", { class: "band" }, ` (${told(own.low, 2)} to ${told(own.high, 2)})`)] : "";
      },
    });
  return [
    heading("Win probabilities"),
    dataTable({
      caption: `Probability that the row is better than the column by ${metric} on an unseen scene, 95 % interval; ${group}`,
      name: `wins ${metric}`,
      columns,
      rows: numbers,
    }),
  ];
};

const imageAddress = (scene, snr, trial, est) => linkTo("images", { scene, snr, trial, est, family: "" });
const imageLink = (scene, snr, trial, est, text) => h("a", { href: imageAddress(scene, snr, trial, est) }, text);

const worstTable = (metric) => {
  const worst = data.ranks[metric]?.worst ?? [];
  if (!worst.length || !rankGroup()) return [];
  const columns = [
    estimatorColumn((row) => row.estimator),
    {
      title: "scene",
      isText: true,
      get: (row) => row.scenario,
      show: (row) => imageLink(row.scenario, row.snr_db, row.trial, [labelOf(row.estimator)], short(row.scenario)),
    },
    { title: metric, get: (row) => row.score },
    { title: "worst image", get: (row) => row.cell_score },
    { title: "SNR [dB]", get: (row) => row.snr_db },
  ];
  return [
    heading("Worst scenes"),
    dataTable({ caption: `Scenes in which each estimator is worst by ${metric}`, name: `worst ${metric}`, columns, rows: worst }),
  ];
};

const failureTable = (rows) => {
  const failed = rows.filter((row) => !isScored(row));
  if (!failed.length) return note("No cell failed.");
  const columns = [...cellColumns(), { title: "reason", isText: true, get: (row) => value("reason", row) }];
  return h(
    "section",
    {},
    heading(`Failed cells: ${failed.length}`),
    dataTable({ caption: "Cells without a score, with the reason", name: "failed cells", columns, rows: failed }),
  );
};

const cellColumns = () => [
  { title: "scene", isText: true, get: sceneName },
  estimatorColumn((row) => data.rows.estimator[row]),
  { title: "SNR [dB]", get: (row) => value("snr_db", row) },
  {
    title: "trial",
    get: (row) => value("trial", row),
    show: (row) => {
      const trial = value("trial", row);
      if (!data.rows.has_image[row]) return String(trial);
      return imageLink(sceneName(row), value("snr_db", row), trial, [labelOf(data.rows.estimator[row])], `${trial}, image`);
    },
  },
  {
    title: "status",
    isText: true,
    get: (row) => value("status", row),
    show: (row) => h("span", { class: isScored(row) ? null : "bad" }, value("status", row)),
  },
];

const factTables = () =>
  data.runs.map((run) => {
    const title = data.runs.length > 1 ? `About the run ${short(run.name)}` : "About the run: command, machine, versions";
    const rows = Object.entries(run.facts).map(([name, own]) =>
      h("tr", {}, h("th", { scope: "row", class: "text" }, name), h("td", { class: "text" }, own)),
    );
    const table = h("table", {}, h("tbody", {}, rows));
    return h("details", {}, h("summary", {}, title), h("div", { class: "scroll", tabindex: 0, role: "region", "aria-label": title }, table));
  });
const parameterTable = () =>
  h(
    "details",
    {},
    h("summary", {}, "Parameters of the estimators"),
    dataTable({
      caption: "Parameters as the rows have them",
      name: "parameters",
      columns: [
        estimatorColumn((one) => one),
        { title: "parameters", isText: true, style: "command", get: (one) => data.estimators[one].params },
      ],
      rows: estimatorNumbers(),
    }),
  );

const buildOverview = (root) => {
  const box = h("div");
  const choices = controls(familyControl(), sceneControl(), snrControl(), metricControl());
  root.append(factsOf(), choices, box, ...factTables(), parameterTable());
  return () => drawOverview(box);
};
