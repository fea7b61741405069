/* Comparison: regressions first, each with both images at its worst cell. */

const buildComparison = (root) => {
  const own = data.comparison,
    panels = new CloudPanels(),
    said = h("h2", { tabindex: -1 });
  const table = h("div"),
    text = note();
  root.append(h("p", { class: own.is_regression ? "bad" : null }, own.summary), note(own.heading.join("; ")));
  root.append(
    controls(
      selectControl("what", "Show", [
        ["", "curves, and points that changed"],
        ["curve", "curves"],
        ["regression", "regressions"],
        ["improvement", "improvements"],
      ]),
    ),
    table,
    said,
    text,
    panels.element,
  );
  root.append(...own.lines.map(note));
  for (const { what, cells, n } of own.lost)
    root.append(
      heading(`${counted(n, "cell")} ${what}`),
      dataTable({
        caption: `Cells ${what}; at most 50 are listed`,
        name: what,
        columns: ["scenario", "estimator", "snr_db", "trial", "status", "reason"].map((name) => ({
          title: name,
          isText: ["scenario", "estimator", "status", "reason"].includes(name),
          get: (row) => row[name],
        })),
        rows: cells,
      }),
    );
  const names = (row) => unique([row.base, row.new].filter((one) => one !== null).map(labelOf)).join(" → ");
  const change = (row) => [
    told(row.change),
    h("span", { class: "band" }, row.change_low === null ? "" : ` (${told(row.change_low)} to ${told(row.change_high)})`),
  ];
  return () => {
    const rows = own.rows
      .map((row, i) => ({ ...row, i }))
      .filter((row) => !state.what || row.what === state.what || row.verdict === state.what);
    const columns = [
      { title: "verdict", isText: true, get: (row) => row.verdict, show: (row) => h("span", { class: row.verdict }, row.verdict) },
      { title: "score", isText: true, get: (row) => row.metric },
      { title: "estimators", isText: true, get: names },
      { title: "scene", isText: true, get: (row) => row.scenario },
      {
        title: "SNR [dB]",
        get: (row) => row.snr_db ?? null,
        show: (row) => (row.snr_db === null || row.snr_db === undefined ? "all" : told(row.snr_db)),
      },
      { title: "pairs", get: (row) => row.n_pairs },
      { title: own.sides[0], csv: "base", get: (row) => row.base_mean },
      { title: own.sides[1], csv: "new", get: (row) => row.new_mean },
      { title: "change", about: "95 % bootstrap interval", get: (row) => row.change, show: change },
      { title: "p worse", get: (row) => row.p_worse },
      {
        title: "worst cell",
        isText: true,
        get: (row) => (row.worst ? `${row.worst.scene}, ${row.worst.snr_db} dB, trial ${row.worst.trial}` : ""),
        show: (row) => {
          if (!row.worst) return "";
          const open = () => (setState({ row: String(row.i) }, true), said.focus());
          const cell = `Images: ${short(row.worst.scene, 30)}, ${row.worst.snr_db} dB, trial ${row.worst.trial}`;
          return h("button", { type: "button", "data-key": `row ${row.i}`, onclick: open }, cell);
        },
      },
    ];
    const caption = `${own.tolerances.join(", ")}; the ${own.unit} is the unit`;
    table.replaceChildren(dataTable({ caption, name: "comparison", columns, rows }));
    const row = rows.find((one) => String(one.i) === state.row) ?? rows.find((one) => one.worst);
    panels.element.hidden = !row?.worst;
    if (!row?.worst) return said.replaceChildren("No images to compare");
    const scene = data.sceneNumber.get(row.worst.scene);
    said.replaceChildren(
      `${row.verdict}: ${row.metric}, ${short(names(row))} on ${short(row.worst.scene)}, ${row.worst.snr_db} dB, trial ${row.worst.trial}`,
    );
    const { scene: name, snr_db: snr, trial } = row.worst;
    const link = imageLink(name, snr, trial, unique([row.base, row.new]).map(labelOf), "Open it among the images");
    text.replaceChildren("The cell in which the score got worse most. ", link, ".");
    if (!data.scenes[scene]?.truth.length) return panels.element.replaceChildren("The truth of this scene is not stored.");
    panels.draw([row.base, row.new].map((one) => imageOf(scene, one, row.worst.snr_db, row.worst.trial)));
  };
};
