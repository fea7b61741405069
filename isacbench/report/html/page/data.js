"use strict";
/* Data of the page: content, rows, clouds, and the state that stands in the address. */

let data, clouds;

const unpack = async (id) => {
  const bytes = Uint8Array.from(atob(document.getElementById(id).textContent), (letter) => letter.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
};

/* Clouds as pack_clouds of Python lays them out. */
class Clouds {
  constructor(bytes, counts) {
    this.counts = counts;
    this.limits = new Float32Array(bytes.buffer, 0, 10 * counts.length);
    this.bytes = bytes.subarray(40 * counts.length);
    this.starts = [0];
    for (const count of counts) this.starts.push(this.starts.at(-1) + count);
    this.total = this.starts.at(-1);
  }

  at(index) {
    const n = this.counts[index],
      start = this.starts[index];
    const [x, y, z, v, power] = [0, 1, 2, 3, 4].map((axis) => {
      const low = this.limits[10 * index + 2 * axis],
        step = this.limits[10 * index + 2 * axis + 1];
      const first = 2 * axis * this.total + start,
        second = first + this.total,
        values = new Float64Array(n);
      for (let i = 0; i < n; i++)
        values[i] = low + step * (axis < 4 ? 256 * this.bytes[first + i] + this.bytes[second + i] : this.bytes[first + i]);
      return values;
    });
    return { n, x, y, z, v, power };
  }
}

const value = (name, row) => {
  const column = data.rows[name];
  if (!column) return null;
  return Array.isArray(column) ? column[row] : column.levels[column.codes[row]];
};
const mean = (values) => (values.length ? values.reduce((sum, one) => sum + one, 0) / values.length : null);
const nearTo = (values, wanted) => values.reduce((best, one) => (Math.abs(one - wanted) < Math.abs(best - wanted) ? one : best));
const extent = (values) => values.reduce(([least, most], one) => [Math.min(least, one), Math.max(most, one)], [Infinity, -Infinity]);
const labelOf = (estimator) => data.estimators[estimator].label;
const sceneName = (row) => data.scenes[data.rows.scene[row]].name;
const isScored = (row) => data.scored.includes(value("status", row));
const unique = (values) => [...new Set(values)];
const metricOf = (name) => data.metrics.find((metric) => metric.name === name) ?? data.metrics[0];

const truthOf = (scene, trial) => {
  const own = data.scenes[scene].truth.find(([of]) => of === null || of === trial);
  return own ? clouds.at(own[1]) : null;
};

/* Rows by the parts of their key. */
const rowsWhere = (test) => {
  const found = [];
  for (let row = 0; row < data.n; row++) if (test(row)) found.push(row);
  return found;
};
const rowAt = (scene, estimator, snr, trial) => data.byCell.get(`${scene}|${estimator}|${snr}|${trial}`) ?? null;

/* Mean and half width of its 95 % interval (Student's t); no width of fewer values than the tables take. */
const meanBand = (values) => {
  const n = values.length,
    middle = mean(values);
  if (n < data.min_trials) return { mean: middle, band: null };
  const variance = values.reduce((sum, one) => sum + (one - middle) ** 2, 0) / (n - 1);
  const student = data.student[n - 2] ?? 1.959964 + 2.3724 / (n - 1);
  return { mean: middle, band: student * Math.sqrt(variance / n) };
};

const valuesOf = (rows, name) => rows.map((row) => value(name, row)).filter((one) => one !== null && one !== undefined);

const grouped = (rows, key) => {
  const found = new Map();
  for (const row of rows) {
    const own = key(row);
    if (!found.has(own)) found.set(own, []);
    found.get(own).push(row);
  }
  return found;
};

const median = (values) => {
  if (!values.length) return null;
  const sorted = [...values].sort((a, b) => a - b),
    middle = sorted.length >> 1;
  return sorted.length % 2 ? sorted[middle] : (sorted[middle - 1] + sorted[middle]) / 2;
};

/* Mean of a metric over the scored rows of one estimator, of times the median: over trials; over scenes where they are the units. A
   reference has the mean spread over its realisations as its band. */
const summary = (given, metric, overScenes) => {
  const rows = given.filter(isScored);
  if (metric.is_median) return { mean: median(valuesOf(rows, metric.name)), band: null };
  const spreads = metric.spread ? valuesOf(rows, metric.spread) : [];
  const units = [...grouped(rows, overScenes ? (row) => data.rows.scene[row] : (row) => data.rows.trial[row]).values()]
    .map((part) => valuesOf(part, metric.name))
    .filter((part) => part.length)
    .map(mean);
  const found = meanBand(units);
  if (spreads.length && !overScenes) found.band = mean(spreads);
  return found;
};

/* The state, all of it in the address. */
const LISTS = ["est", "hide"];
const EVERY = "*"; // value of scene: the mean over all
let state = {};

const readState = () => {
  const given = new URLSearchParams(location.hash.slice(1));
  state = Object.fromEntries([...given.keys()].filter((key) => !LISTS.includes(key)).map((key) => [key, given.get(key)]));
  for (const key of LISTS) state[key] = given.getAll(key);
  normalise();
};

/* What does not apply to this page is dropped, so that nothing acts which no control shows. */
const normalise = () => {
  if (!Object.hasOwn(views, state.view ?? "") || !views[state.view].isAvailable())
    state.view = Object.keys(views).find((name) => views[name].isAvailable());
  const keep = (key, isKnown) => (state[key] !== undefined && !isKnown(state[key]) ? delete state[key] : null);
  keep("scene", (own) => own === EVERY || data.sceneNumber.has(own));
  keep("family", (own) => data.scenes.some((scene) => scene.family === own));
  keep("family", (own) => !data.sceneNumber.has(state.scene) || data.scenes[data.sceneNumber.get(state.scene)].family === own);
  keep("snr", (own) => data.snrs.includes(Number(own)) && own !== "");
  keep("trial", (own) => own !== "" && data.trials.includes(Number(own)));
  keep("metric", (own) => own === "every" || data.metrics.some((metric) => metric.name === own));
  state.est = state.est.filter((own) => data.estimators.some((one) => one.label === own));
};

const addressOf = (wanted) => {
  const parameters = new URLSearchParams();
  for (const [key, own] of Object.entries(wanted)) {
    if (Array.isArray(own)) own.forEach((one) => parameters.append(key, one));
    else if (own !== "" && own !== null && own !== undefined) parameters.set(key, own);
  }
  return `#${parameters}`;
};

let onStateStored = () => {};
const setState = (changes, isStep = false) => {
  state = { ...state, ...changes };
  normalise();
  if (isStep) history.pushState(null, "", addressOf(state));
  else history.replaceState(null, "", addressOf(state));
  onStateStored();
  render();
};

/* A link to another view keeps scene, SNR, trial and estimators. */
const linkTo = (view, changes = {}) => {
  const kept = Object.fromEntries(["scene", "snr", "trial", "est", "metric", "family"].map((key) => [key, state[key]]));
  return addressOf({ view, ...kept, ...changes });
};

/* Shell command that takes and draws an image again. */
const shellWord = (word) => (/^[\w@%+=:,./-]+$/.test(word) ? word : `'${word.replaceAll("'", `'"'"'`)}'`);
const commandFor = (scene, estimator, snr, trial) => {
  const told = data.scenes[scene];
  if (!told.text) return "";
  const words = ["isacbench", "image", "-s", told.text, "-e", data.estimators[estimator].spec, "--snr", String(snr)];
  if (trial) words.push("--trial", String(trial));
  if (told.seed) words.push("--seed", String(told.seed));
  return [...words, "--plot", "image.png"].map(shellWord).join(" ");
};
