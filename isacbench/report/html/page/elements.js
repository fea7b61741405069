/* Elements and controls. Names and reasons of a run become text, never markup. */

const h = (tag, properties = {}, ...children) => {
  const element = document.createElement(tag);
  for (const [name, own] of Object.entries(properties)) {
    if (own === null || own === undefined || own === false) continue;
    if (name.startsWith("on")) element.addEventListener(name.slice(2), own);
    else if (name === "style") Object.assign(element.style, own);
    else element.setAttribute(name, own === true ? "" : own);
  }
  element.append(...children.flat(2).filter((child) => child !== null && child !== undefined && child !== false));
  return element;
};

const LONGEST = 80;
const short = (text, longest = LONGEST) => (text.length > longest ? `${text.slice(0, longest - 1)}…` : text);

/* Text for plotly, which would read tags in it. */
const plain = (text, longest = 48) => short(String(text), longest).replaceAll("&", "&amp;").replaceAll("<", "&lt;").replaceAll(">", "&gt;");

const told = (number, digits = 3) => {
  if (number === null || number === undefined || Number.isNaN(number)) return "";
  if (number === 0 || Number.isInteger(number)) return String(number);
  const size = Math.abs(number);
  return size >= 1e5 || size < 1e-3 ? number.toExponential(digits - 1) : String(Number(number.toPrecision(size >= 1000 ? 4 : digits)));
};
const counted = (n, noun) => `${n} ${noun}${n === 1 ? "" : "s"}`;

let syncs = [];
let lastId = 0;

const labelled = (label, control) => {
  control.id = `e${++lastId}`;
  return h("div", {}, h("label", { for: control.id }, label), control);
};

/* A choice of one; options are [value, text]. The key is that of the state. */
const selectControl = (key, label, options, fallback = "", changes = () => ({})) => {
  const control = h("select", {
    onchange: () => setState({ [key]: control.value, ...changes(control.value) }, true),
  });
  const sync = () => {
    const own = typeof options === "function" ? options() : options;
    control.replaceChildren(...own.map(([one, text]) => h("option", { value: one }, short(String(text)))));
    const wanted = String(state[key] ?? fallback);
    control.value = own.some(([one]) => String(one) === wanted) ? wanted : String(own[0]?.[0] ?? "");
  };
  syncs.push(sync);
  return labelled(label, control);
};

/* A slider over listed values. */
const sliderControl = (key, label, values, unit, current) => {
  const output = h("output", {}),
    control = h("input", { type: "range", min: 0, step: 1 });
  control.addEventListener("input", () => setState({ [key]: String(values()[Number(control.value)]) }));
  syncs.push(() => {
    const own = values(),
      text = `${told(current(), 6)}${unit}`;
    control.max = Math.max(own.length - 1, 0);
    control.disabled = own.length < 2;
    control.value = own.indexOf(current());
    output.textContent = ` ${text}`;
    control.setAttribute("aria-valuetext", text);
  });
  const box = labelled(label, control);
  box.append(output);
  return box;
};

/* Several of a list; options are [value, text, colour]. */
const checksControl = (key, legend, options, chosen, most = Infinity) => {
  const box = h("div", { class: "choices" });
  let shown = "";
  syncs.push(() => {
    const own = options(),
      names = JSON.stringify(own);
    if (names !== shown) {
      box.replaceChildren(
        ...own.map(([one, text, colour]) => {
          const check = h("input", { type: "checkbox", value: one });
          check.addEventListener("change", () => {
            const others = chosen().filter((other) => other !== one);
            setState({ [key]: check.checked ? [...others.slice(-(most - 1)), one] : others }, true);
          });
          const swatch = colour ? h("span", { class: "swatch", style: { background: colour } }) : null;
          return h("label", { title: text }, check, swatch, h("span", {}, short(text, 40)));
        }),
      );
      shown = names;
    }
    const wanted = chosen();
    for (const check of box.querySelectorAll("input")) check.checked = wanted.includes(check.value);
  });
  return h("fieldset", {}, h("legend", {}, legend), box);
};

const buttonsControl = (key, legend, options, current) => {
  const buttons = options.map(([one, text]) =>
    h("button", { type: "button", value: one, onclick: () => setState({ [key]: one }, true) }, text),
  );
  syncs.push(() => buttons.forEach((button) => button.setAttribute("aria-pressed", String(button.value === current()))));
  return h("fieldset", {}, h("legend", {}, legend), buttons);
};

/* Draw anew, and put the focus back on the control with the same key. */
const keepFocus = (work) => {
  const before = document.activeElement,
    key = before?.dataset?.key;
  work();
  if (key && document.activeElement !== before) document.querySelector(`[data-key="${CSS.escape(key)}"]`)?.focus({ preventScroll: true });
};

const say = (text) => (document.getElementById("status").textContent = text);

const saveFile = (name, address) => {
  const link = h("a", { href: address, download: name });
  document.body.append(link);
  link.click();
  link.remove();
  say(`${name} saved`);
};
const fileName = (text, extension) => `${short(text.replace(/[^\w.-]+/g, "-").replace(/^-+|-+$/g, "") || "figure", 60)}.${extension}`;
