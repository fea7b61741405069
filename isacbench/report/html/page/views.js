/* The views. Each builds its controls once, and returns what it draws anew whenever the state changes. */

const imagedCount = () => data.scenes.filter((scene) => scene.truth.length).length;

const views = {
  comparison: { title: "Comparison", isAvailable: () => Boolean(data.comparison), build: buildComparison },
  overview: { title: "Overview", isAvailable: () => true, build: buildOverview },
  curves: { title: "Curves", isAvailable: () => data.metrics.length > 0, build: buildCurves },
  images: { title: "Images", isAvailable: () => imagedCount() > 0, build: buildImages },
  maps: { title: "Maps", isAvailable: () => Boolean(data.maps?.maps?.length), build: buildMaps },
  scenes: { title: "Scenes", isAvailable: () => imagedCount() > 1, build: buildScenes },
  time: { title: "Time against error", isAvailable: () => Boolean(data.times.points), build: buildTime },
  study: { title: "Study", isAvailable: () => data.charts.length > 0, build: buildStudy },
  rows: { title: "Rows", isAvailable: () => data.n > 0, build: buildRows },
};
const titleOf = (view) => (view === "study" && STUDIES[data.suite_kind]) || views[view].title;
