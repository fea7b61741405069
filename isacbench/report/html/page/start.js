/* The start of the page, and drawing anew when the state, the theme or the medium changes. */

let current = null;

const render = () => {
  const main = document.getElementById("main");
  if (current?.view !== state.view) {
    forget();
    syncs = [];
    main.replaceChildren(h("h2", { class: "for-readers" }, titleOf(state.view)));
    current = { view: state.view, update: views[state.view].build(main) };
  }
  keepFocus(() => {
    syncs.forEach((sync) => sync());
    current.update();
  });
  const linkOf = (name) => {
    const isCurrent = name === state.view ? "page" : null;
    return h("li", {}, h("a", { href: linkTo(name), "aria-current": isCurrent, onclick: focusMain }, titleOf(name)));
  };
  const available = Object.keys(views).filter((name) => views[name].isAvailable());
  document.getElementById("views").replaceChildren(...available.map(linkOf));
};
const focusMain = () => setTimeout(() => document.getElementById("main").focus({ preventScroll: true }));
const renderAnew = () => {
  current = null;
  render();
};

const start = async () => {
  if (!window.DecompressionStream) {
    document.getElementById("loading").textContent =
      "This browser is too old for the page: it needs Chrome 93, Firefox 113, Safari 16.4 or later.";
    return;
  }
  data = JSON.parse(new TextDecoder().decode(await unpack("content")));
  clouds = new Clouds(await unpack("clouds"), data.counts);
  data.n = data.rows.estimator.length;
  const all = rowsWhere(() => true);
  data.snrs = numbersOf("snr_db", all);
  data.trials = numbersOf("trial", all);
  data.sceneNumber = new Map(data.scenes.map((scene, i) => [scene.name, i]));
  const cellOf = (row) => [data.rows.scene[row], data.rows.estimator[row], value("snr_db", row), value("trial", row)].join("|");
  data.byCell = new Map(all.map((row) => [cellOf(row), row]));
  const title = document.getElementById("title");
  title.title = title.textContent;
  readState();
  render();
  // A link within the page fires both events.
  let latest = location.hash;
  for (const event of ["popstate", "hashchange"])
    addEventListener(event, () => {
      if (location.hash === latest) return;
      latest = location.hash;
      readState();
      render();
    });
  onStateStored = () => (latest = location.hash);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", renderAnew);
  matchMedia("print").addEventListener("change", () => current?.update());
  document.getElementById("skip").addEventListener("click", () => document.getElementById("main").focus());
  document.body.dataset.ready = String(Math.round(performance.now()));
  setTimeout(plotly, 50);
};

start();
