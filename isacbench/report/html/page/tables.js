/* Tables that sort by a click on their heads and can be saved as CSV. */

const FORMULA = /^[=+\-@\t\r]/;
const csvCell = (cell) => {
  if (cell === null || cell === undefined) return "";
  if (typeof cell === "number") return String(cell);
  const text = FORMULA.test(cell) ? `'${cell}` : String(cell);
  return `"${text.replaceAll('"', '""')}"`;
};
const saveCsv = (name, columns, rows) => {
  const cells = [columns.map((column) => column.csv ?? column.title), ...rows.map((row) => columns.map((column) => column.get(row)))];
  const text = cells.map((own) => `${own.map(csvCell).join(",")}\n`).join("");
  saveFile(fileName(name, "csv"), URL.createObjectURL(new Blob([text], { type: "text/csv" })));
};

const PAGE = 100;

/* A table. Columns have title, get (value to sort and save), and optionally show (content of the cell), isText,
   csv (name in the file), about (tooltip), isHidden (only saved). The order is that of the state under sortKey, or its own. */
const dataTable = ({ caption, columns, rows, name, sortKey = null, first = null, rowClass = null, page = PAGE }) => {
  const box = h("div", {}),
    own = { sort: first ?? "", shown: page };
  const order = () => (sortKey ? (state[sortKey] ?? first ?? "") : own.sort);
  const choose = (wanted) => {
    if (sortKey) return setState({ [sortKey]: wanted });
    own.sort = wanted;
    keepFocus(draw);
  };
  const draw = () => {
    const at = order().lastIndexOf("|"),
      [title, direction] = [order().slice(0, at), order().slice(at + 1)],
      sorted = columns.find((column) => column.title === title);
    const listed = [...rows];
    if (sorted) {
      const sign = direction === "down" ? -1 : 1;
      const isEmpty = (one) => one === null || one === undefined || one === "";
      listed.sort((one, other) => {
        const [a, b] = [sorted.get(one), sorted.get(other)];
        if (isEmpty(a) || isEmpty(b)) return isEmpty(a) - isEmpty(b);
        return (
          sign * (typeof a === "number" && typeof b === "number" ? a - b : String(a).localeCompare(String(b), "en", { numeric: true }))
        );
      });
    }
    const visible = columns.filter((column) => !column.isHidden);
    const heads = visible.map((column) => {
      const isOwn = column === sorted;
      const next = `${column.title}|${isOwn && direction !== "down" ? "down" : "up"}`;
      return h(
        "th",
        {
          scope: "col",
          class: column.isText ? "text" : null,
          title: column.about,
          "aria-sort": isOwn ? (direction === "down" ? "descending" : "ascending") : null,
        },
        h("button", { type: "button", "data-key": `${name}|${column.title}`, onclick: () => choose(next) }, column.title),
      );
    });
    const body = listed.slice(0, own.shown).map((row) =>
      h(
        "tr",
        { class: rowClass?.(row) },
        visible.map((column, index) => {
          const content = column.show ? column.show(row) : column.get(row);
          const text = typeof content === "number" ? told(content) : content;
          const isHead = !index && column.isText;
          const style = column.isText ? `text ${column.style ?? ""}` : null;
          return h(isHead ? "th" : "td", { class: style, scope: isHead ? "row" : null }, text ?? "");
        }),
      ),
    );
    const table = h("table", {}, h("caption", {}, caption), h("thead", {}, h("tr", {}, heads)), h("tbody", {}, body));
    const showMore = () => ((own.shown += 10 * PAGE), keepFocus(draw));
    const text = `Show more: ${own.shown} of ${listed.length} rows are shown`;
    const isMore = listed.length > own.shown;
    const more = isMore ? h("button", { type: "button", "data-key": `${name}|more`, onclick: showMore }, text) : null;
    const save = h("button", { type: "button", onclick: () => saveCsv(name, columns, listed) }, "Save rows as CSV");
    box.replaceChildren(
      h("div", { class: "scroll", tabindex: 0, role: "region", "aria-label": caption }, table),
      h("div", { class: "tools" }, more, save),
    );
  };
  draw();
  return box;
};

/* Table in the place of a figure, made when it is opened. */
const tableBelow = (make) => {
  const box = h("details", {}, h("summary", {}, "Table"));
  box.addEventListener("toggle", () => {
    if (box.open && box.children.length < 2) box.append(make());
  });
  return box;
};

const nameCell = (estimator) => {
  const own = data.estimators[estimator];
  const colour = colourOf(own);
  return h(
    "span",
    { class: "name", title: own.label },
    h("span", { class: "swatch", style: { background: colour } }),
    ` ${short(own.label)}`,
    own.role ? h("span", { class: "role" }, own.role) : null,
  );
};
const estimatorColumn = (of, title = "estimator") => ({
  title,
  isText: true,
  get: (row) => labelOf(of(row)),
  show: (row) => nameCell(of(row)),
});
const withBand = ({ mean, band }) => [
  told(mean),
  band === null || band === undefined ? null : h("span", { class: "band" }, ` ± ${told(band, 2)}`),
];
