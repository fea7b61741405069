/* Images: truth and estimates as turning clouds, and the projections of the metric. */

const PLANES = [
  ["xy", "x", "y"],
  ["xz", "x", "z"],
  ["yz", "y", "z"],
];
const MOST_SHOWN = 4;

/* Nearest point of the others for every point; coordinates are lists. */
const nearest = ([x, y, z], [ox, oy, oz]) => {
  const n = x.length,
    m = ox.length,
    distance = new Float64Array(n),
    index = new Int32Array(n);
  const isFlat = !z;
  for (let i = 0; i < n; i++) {
    let least = Infinity,
      at = -1;
    for (let j = 0; j < m; j++) {
      const square = (x[i] - ox[j]) ** 2 + (y[i] - oy[j]) ** 2 + (isFlat ? 0 : (z[i] - oz[j]) ** 2);
      if (square < least) [least, at] = [square, j];
    }
    [distance[i], index[i]] = [Math.sqrt(least), at];
  }
  return { distance, index };
};
const farthest = ({ distance, index }) => {
  let place = -1;
  distance.forEach((one, i) => (place < 0 || one > distance[place]) && (place = i));
  return place < 0 ? null : { distance: distance[place], from: place, to: index[place] };
};

/* A cloud and its truth: distances, and in each plane the two points that make the Hausdorff distance. */
const pairOf = (truth, cloud) => {
  const space = (one) => [one.x, one.y, one.z];
  let planes = null;
  return {
    ofCloud: nearest(space(cloud), space(truth)),
    ofTruth: nearest(space(truth), space(cloud)),
    get planes() {
      return (planes ??= planesOf(truth, cloud));
    },
  };
};
const planesOf = (truth, cloud) => {
  const planes = {};
  for (const [plane, a, b] of PLANES) {
    if (!truth.n || !cloud.n) continue;
    const missed = farthest(nearest([truth[a], truth[b]], [cloud[a], cloud[b]]));
    const stray = farthest(nearest([cloud[a], cloud[b]], [truth[a], truth[b]]));
    const isMissed = missed.distance >= stray.distance,
      own = isMissed ? missed : stray;
    planes[plane] = {
      distance: own.distance,
      truth: isMissed ? own.from : own.to,
      point: isMissed ? own.to : own.from,
      isMissed,
    };
  }
  return planes;
};

/* One image: its row, cloud, truth and what the page knows of them. The latest ones are remembered. */
const remembered = new Map();
const MOST_REMEMBERED = 300;
const imageOf = (scene, estimator, snr, trial) => {
  const key = `${scene}|${estimator}|${snr}|${trial}`;
  if (!remembered.has(key)) {
    if (remembered.size >= MOST_REMEMBERED) remembered.delete(remembered.keys().next().value);
    remembered.set(key, newImage(scene, estimator, snr, trial));
  }
  return remembered.get(key);
};
const newImage = (scene, estimator, snr, trial) => {
  const row = rowAt(scene, estimator, snr, trial),
    truth = truthOf(scene, trial);
  const image = { row, scene, estimator, snr, trial, truth, cloud: null, pair: null, note: "not run" };
  if (row === null) return image;
  const status = value("status", row);
  if (!isScored(row)) return { ...image, note: `${status}: ${value("reason", row)}` };
  const index = data.rows.cloud[row];
  if (index < 0) return { ...image, note: data.rows.has_image[row] ? "left out of this page" : "no cloud is stored" };
  const cloud = clouds.at(index);
  const scores = Object.entries({ hausdorff_sum_m: ["Hausdorff sum", " m"], precision: ["precision", ""], recall: ["recall", ""] })
    .filter(([name]) => valuesOf([row], name).length)
    .map(([name, [title, unit]]) => `${title} ${told(value(name, row))}${unit}`);
  const what = status === "no_detection" ? "nothing detected" : counted(cloud.n, "point");
  const of = data.estimators[estimator].is_reference ? ", one of its realisations; scores are means over all" : "";
  return { ...image, cloud, pair: pairOf(truth, cloud), note: [what + of, ...scores].join(", ") };
};

const objectsOf = (scene) => data.scenes[scene].objects ?? { codes: [], levels: [] };
/* Whether points are shown: those of the truth by their object, estimated ones by that of the nearest scatterer. */
const shownTruth = (scene) => {
  const { codes, levels } = objectsOf(scene),
    hidden = levels.map((level) => state.hide.includes(level));
  return (i) => !hidden[codes[i]];
};

const velocityScale = (scene) => {
  const most = Math.asinh(Math.max(data.scenes[scene].speed_mps ?? 10, 1) / 2);
  const ticks = [-100, -50, -20, -10, -5, -2, 0, 2, 5, 10, 20, 50, 100].filter((tick) => Math.abs(Math.asinh(tick / 2)) <= most);
  const colours = [...data.velocity_colours];
  if (isDark()) colours[2] = "#d8d8d8";
  return {
    colorscale: colours.map((colour, i) => [i / (colours.length - 1), colour]),
    cmin: -most,
    cmax: most,
    colorbar: {
      title: { text: "m/s", side: "right" },
      tickvals: ticks.map((tick) => Math.asinh(tick / 2)),
      ticktext: ticks.map(String),
      thickness: 10,
      len: 0.75,
      outlinewidth: 0,
    },
  };
};

const picked = (points, places) => ["x", "y", "z"].map((name) => places.map((i) => points[name][i]));

/* What hovering tells of a point. */
const hoverText = (image, points, i, isTruth) => {
  const { pair } = image,
    own = pair && (isTruth ? pair.ofTruth : pair.ofCloud);
  const lines = [
    `(${points.x[i].toFixed(2)}, ${points.y[i].toFixed(2)}, ${points.z[i].toFixed(2)}) m`,
    `${points.v[i].toFixed(2)} m/s, ${points.power[i].toFixed(1)} dB`,
  ];
  const { codes, levels } = objectsOf(image.scene);
  if (own && Number.isFinite(own.distance[i])) lines.push(`${told(own.distance[i])} m to ${isTruth ? "the nearest point" : "the truth"}`);
  const object = levels[codes[isTruth ? i : own?.index[i]]];
  if (object) lines.push(plain(object));
  return lines.join("<br>");
};

const trace3d = (image, points, places, marker, name, isTruth = false) => {
  const [x, y, z] = picked(points, places);
  return {
    type: "scatter3d",
    mode: "markers",
    x,
    y,
    z,
    name,
    text: places.map((i) => hoverText(image, points, i, isTruth)),
    hovertemplate: "%{text}<extra></extra>",
    marker: { line: { width: 0 }, ...marker },
    showlegend: false,
  };
};

/* Traces of one panel: the truth alone where there is no estimate. */
const panelTraces = (image, scale, isLast) => {
  const { truth, cloud, pair, scene } = image,
    radius = data.scenes[scene].radius_m,
    colour = state.colour ?? "velocity";
  const isTrueShown = shownTruth(scene),
    trueAt = [...Array(truth.n).keys()].filter(isTrueShown);
  const bySpeed = (points, places, more) => ({
    color: places.map((i) => Math.asinh(points.v[i] / 2)),
    ...scale,
    showscale: isLast,
    ...more,
  });
  if (!cloud) {
    const marker = colour === "velocity" ? bySpeed(truth, trueAt, { size: 3 }) : { size: 3, color: css("fg") };
    return [trace3d(image, truth, trueAt, marker, "truth", true)];
  }
  const shownAt = [...Array(cloud.n).keys()].filter((i) => !truth.n || isTrueShown(pair.ofCloud.index[i]));
  const isFalse = (i) => pair.ofCloud.distance[i] > radius;
  const foundAt = shownAt.filter((i) => !isFalse(i)),
    falseAt = shownAt.filter(isFalse);
  const traces = [trace3d(image, truth, trueAt, { size: 2, color: css("truth"), opacity: 0.55 }, "truth", true)];
  if (colour === "velocity") {
    traces.push(trace3d(image, cloud, foundAt, bySpeed(cloud, foundAt, { size: 3.6 }), "found"));
    traces.push(
      trace3d(image, cloud, falseAt, { ...bySpeed(cloud, falseAt, { size: 4.2, symbol: "diamond" }), showscale: false }, "false"),
    );
  } else if (colour === "error") {
    const error = {
      color: shownAt.map((i) => Math.min(pair.ofCloud.distance[i], 2 * radius)),
      cmin: 0,
      cmax: 2 * radius,
      colorscale: "Cividis",
      showscale: isLast,
      colorbar: { title: { text: "m to truth", side: "right" }, thickness: 10, len: 0.75, outlinewidth: 0 },
    };
    traces.push(trace3d(image, cloud, shownAt, { size: 3.6, ...error }, "estimate"));
  } else {
    const missedAt = trueAt.filter((i) => !(pair.ofTruth.distance[i] <= radius));
    traces.push(trace3d(image, cloud, foundAt, { size: 3.4, color: css("found") }, "found"));
    traces.push(trace3d(image, cloud, falseAt, { size: 4.2, color: css("false"), symbol: "diamond" }, "false"));
    traces.push(trace3d(image, truth, missedAt, { size: 4, color: css("missed"), symbol: "square-open" }, "missed", true));
  }
  return traces;
};

const START_EYE = { x: 1.65, y: 1.9, z: 1.15 };
const CENTRE = { x: 0, y: 0, z: -0.12 };
/* Where the camera stands and looks; in the address six numbers. */
const cameraOf = () => {
  const given = (state.camera ?? "").split(",").map(Number);
  if (given.length !== 6 || !given.every(Number.isFinite)) return { eye: START_EYE, center: CENTRE };
  const [x, y, z, a, b, c] = given;
  return { eye: { x, y, z }, center: { x: a, y: b, z: c } };
};
const cameraText = ({ eye, center }) => [eye.x, eye.y, eye.z, center.x, center.y, center.z].map((one) => one.toFixed(3)).join(",");

/* Clouds of one scene side by side with one camera. */
class CloudPanels {
  constructor() {
    this.element = h("div", { class: "grid clouds" });
    this.figures = [];
    this.key = "";
    this.turning = false;
  }

  /* Turn all clouds but the one that was turned; of cameras that come meanwhile the latest. */
  turnAll(camera, from = null) {
    this.wanted = { camera, from };
    if (this.turning) return;
    this.turning = true;
    requestAnimationFrame(async () => {
      while (this.wanted) {
        const { camera: own, from: turned } = this.wanted;
        this.wanted = null;
        const others = this.figures.filter((figure) => figure.plot !== turned && figure.listens && drawn.has(figure.plot));
        const camera = { "scene.camera.eye": own.eye, "scene.camera.center": own.center };
        await Promise.all(others.map((figure) => window.Plotly.relayout(figure.plot, camera)));
      }
      this.turning = false;
    });
  }

  store(camera) {
    state.camera = cameraText(camera);
    history.replaceState(null, "", addressOf(state));
    onStateStored();
  }

  keys(event) {
    if (event.ctrlKey || event.altKey || event.metaKey) return;
    const { eye, center } = cameraOf(),
      flat = Math.hypot(eye.x, eye.y);
    let turn = Math.atan2(eye.y, eye.x),
      rise = Math.atan2(eye.z, flat),
      far = Math.hypot(flat, eye.z);
    const steps = {
      ArrowLeft: () => (turn -= 0.12),
      ArrowRight: () => (turn += 0.12),
      ArrowUp: () => (rise += 0.1),
      ArrowDown: () => (rise -= 0.1),
      "+": () => (far /= 1.12),
      "-": () => (far *= 1.12),
    };
    if (event.key === "0") return this.look({ eye: START_EYE, center: CENTRE }, event);
    if (!steps[event.key]) return;
    steps[event.key]();
    rise = Math.max(-1.5, Math.min(1.5, rise));
    const level = far * Math.cos(rise);
    this.look({ eye: { x: level * Math.cos(turn), y: level * Math.sin(turn), z: far * Math.sin(rise) }, center }, event);
  }

  look(camera, event) {
    event.preventDefault();
    this.store(camera);
    this.turnAll(camera);
  }

  /* Images of one scene, SNR and trial; the truth stands before them. */
  draw(images) {
    const [{ scene, truth, snr, trial }] = images,
      name = data.scenes[scene].name;
    const first = { scene, truth, cloud: null, pair: null, note: counted(truth.n, "scatterer"), isTruth: true };
    const shown = [first, ...images],
      key = images.map((image) => image.estimator).join("|");
    if (key !== this.key) {
      this.figures.forEach((figure) => (window.Plotly?.purge(figure.plot), drawn.delete(figure.plot)));
      this.figures = shown.map((image) => {
        const title = image.isTruth ? "truth" : labelOf(image.estimator);
        const figure = new Figure({
          title: short(title),
          label: `${short(title)}: turning cloud of points. Arrow keys turn all clouds, plus and minus zoom, 0 resets.`,
          height: 330,
          keys: (event) => this.keys(event),
          name: title,
        });
        const camera = (event) =>
          event["scene.camera"] && !this.turning && (this.store(event["scene.camera"]), this.turnAll(event["scene.camera"], figure.plot));
        figure.whenDrawn = (plot) => (plot.on("plotly_relayout", camera), plot.on("plotly_relayouting", camera));
        return figure;
      });
      this.element.replaceChildren(...this.figures.map((figure) => figure.element));
      this.key = key;
    }
    const points = [truth, ...images.map((image) => image.cloud).filter(Boolean)];
    const isEmpty = points.every((one) => !one.n),
      colours = { gridcolor: css("line"), zerolinecolor: css("line"), color: css("muted"), backgroundcolor: css("panel") };
    const axes = {},
      sizes = {};
    for (const one of ["x", "y", "z"]) {
      const [low, high] = isEmpty ? [0, 0] : extent(points.flatMap((own) => [...own[one]]));
      const margin = Math.max(0.5, 0.02 * (high - low)),
        range = isEmpty ? undefined : [low - margin, high + margin];
      axes[`${one}axis`] = { title: { text: `${one} [m]` }, range, ...colours, showbackground: one === "z" };
      sizes[one] = high - low + 2 * margin;
    }
    const scaling = isEmpty ? 1 : 1.3 / Math.max(...Object.values(sizes)),
      aspectratio = Object.fromEntries(Object.entries(sizes).map(([one, size]) => [one, scaling * size]));
    const scale = velocityScale(scene);
    shown.forEach((image, i) => {
      const figure = this.figures[i];
      figure.note.textContent = image.note;
      if (!image.isTruth && !image.cloud) {
        const command = image.row === null ? "" : commandFor(scene, image.estimator, snr, trial);
        figure.note.replaceChildren(image.note, command ? h("span", {}, ". Take it with: ", h("code", {}, command)) : "");
      }
      const what = image.isTruth ? "True scatterers of" : `Points of ${labelOf(image.estimator)} on`;
      figure.table = () => pointTable(image, image.isTruth ? `${what} ${name}` : `${what} ${name}, ${snr} dB, trial ${trial}`);
      const traces = image.isTruth || image.cloud ? panelTraces(image, scale, i === shown.length - 1) : [];
      figure.plot.hidden = !traces.length;
      if (!traces.length) return figure.clear();
      figure.draw(traces, {
        margin: { l: 0, r: 0, t: 0, b: 0 },
        scene: { ...axes, aspectmode: "manual", aspectratio, camera: cameraOf(), uirevision: "camera" },
        uirevision: "camera",
      });
    });
  }
}

const pointTable = (image, caption) => {
  const points = image.isTruth ? image.truth : image.cloud;
  const rows = points ? [...Array(points.n).keys()] : [];
  const { codes, levels } = objectsOf(image.scene),
    radius = data.scenes[image.scene].radius_m;
  const titles = { x: "x [m]", y: "y [m]", z: "z [m]", v: "velocity [m/s]", power: "power [dB]" };
  const columns = Object.entries(titles).map(([name, title]) => ({
    title,
    get: (i) => Number(points[name][i].toFixed(name === "power" ? 1 : 3)),
  }));
  if (!image.isTruth && image.truth.n)
    columns.push(
      { title: "to the truth [m]", get: (i) => Number(image.pair.ofCloud.distance[i].toFixed(3)) },
      { title: "is", isText: true, get: (i) => (image.pair.ofCloud.distance[i] > radius ? "false" : "found") },
    );
  if (levels.length)
    columns.push({ title: "object", isText: true, get: (i) => levels[codes[image.isTruth ? i : image.pair.ofCloud.index[i]]] });
  return dataTable({ caption, name: caption, columns, rows });
};

/* The three projections of the metric, with the two points that make each Hausdorff distance. */
class Projections {
  constructor() {
    this.figures = PLANES.map(([plane]) => new Figure({ title: plane, label: `Projection ${plane} of truth and estimate`, height: 300 }));
    const elements = this.figures.map((figure) => figure.element);
    this.element = h("div", { class: "grid three" }, elements);
  }

  draw(image) {
    const { truth, cloud, pair, scene } = image,
      radius = data.scenes[scene].radius_m,
      isTrueShown = shownTruth(scene);
    PLANES.forEach(([plane, a, b], i) => {
      const figure = this.figures[i],
        own = pair?.planes[plane];
      figure.heading.textContent = own ? `${plane}: ${told(own.distance)} m` : plane;
      const [far, near] = own?.isMissed ? ["scatterer", "point"] : ["point", "scatterer"];
      figure.note.textContent = own ? `the ${far} that is farthest from all ${near}s, and the nearest ${near}` : image.note;
      const table = () => {
        const caption = `Points that make the Hausdorff distance of ${plane}`;
        const columns = ["point", `${a} [m]`, `${b} [m]`].map((title, at) => ({ title, get: (row) => row[at], isText: !at }));
        const rows = [
          ["true scatterer", truth[a][own.truth], truth[b][own.truth]],
          ["estimated point", cloud[a][own.point], cloud[b][own.point]],
        ];
        return dataTable({ caption, name: plane, columns, rows });
      };
      figure.table = own ? table : null;
      const flat = (points, places, marker, name, isTruth = false) => ({
        type: "scatter",
        mode: "markers",
        x: places.map((k) => points[a][k]),
        y: places.map((k) => points[b][k]),
        marker,
        name,
        text: places.map((k) => hoverText(image, points, k, isTruth)),
        hovertemplate: "%{text}<extra></extra>",
      });
      const trueAt = [...Array(truth.n).keys()].filter(isTrueShown);
      const traces = [flat(truth, trueAt, { symbol: "circle-open", size: 7, color: css("truth") }, "truth", true)];
      if (cloud && pair) {
        const at = [...Array(cloud.n).keys()].filter((k) => isTrueShown(pair.ofCloud.index[k])),
          isFalse = (k) => pair.ofCloud.distance[k] > radius;
        const right = at.filter((k) => !isFalse(k));
        traces.push(
          flat(cloud, right, { size: 5, color: css("found") }, "found"),
          flat(cloud, at.filter(isFalse), { size: 8, symbol: "diamond", color: css("false") }, "false"),
        );
      }
      if (own)
        traces.push({
          type: "scatter",
          mode: "lines+markers",
          name: "Hausdorff distance",
          x: [truth[a][own.truth], cloud[a][own.point]],
          y: [truth[b][own.truth], cloud[b][own.point]],
          line: { color: css("fg"), width: 2.5 },
          marker: { symbol: ["circle-open", "square-open"], size: 14, color: css("fg"), line: { width: 2 } },
          hoverinfo: "skip",
        });
      figure.draw(traces, {
        xaxis: axis({ title: { text: `${a} [m]` }, automargin: false }),
        yaxis: axis({ title: { text: `${b} [m]` }, automargin: false, scaleanchor: "x" }),
        showlegend: i === 0,
      });
    });
  }
}
