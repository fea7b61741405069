/* All rows. */

const buildRows = (root) => {
  const box = h("div");
  const statuses = () => [["", "any status"], ...unique(rowsWhere(() => true).map((row) => value("status", row))).map((one) => [one, one])];
  root.append(
    controls(
      familyControl(),
      sceneControl(),
      snrControl(),
      selectControl("status", "Status", statuses),
      estimatorsControl(),
    ),
    box,
  );
  return () => {
    const rows = filteredRows(["family", "scene", "snr", "est", "status"]);
    const rest = Object.keys(data.rows).filter(
      (name) => !["estimator", "scene", "snr_db", "trial", "status", "cloud", "has_image"].includes(name) && !name.endsWith("_spread"),
    );
    const further = rest.map((name) => ({ title: name, isText: !Array.isArray(data.rows[name]), get: (row) => value(name, row) }));
    const columns = [...cellColumns(), ...further];
    box.replaceChildren(dataTable({ caption: `${rows.length} of ${data.n} rows`, name: "rows", columns, rows, sortKey: "sort" }));
  };
};
