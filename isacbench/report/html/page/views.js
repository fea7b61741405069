/* The views. Each builds its controls once, and returns what it draws anew whenever the state changes. */

const views = {
  comparison: {
    title: () => "Comparison",
    isAvailable: () => Boolean(data.comparison),
    build: buildComparison,
  },
  overview: {
    title: () => "Overview",
    isAvailable: () => true,
    build: (root) => {
      const box = h("div");
      root.append(
        factsOf(),
        controls(familyControl(), sceneControl(), snrControl(), metricControl()),
        box,
        ...factTables(),
        parameterTable(),
      );
      return () => drawOverview(box);
    },
  },
  curves: { title: () => "Curves", isAvailable: () => data.metrics.length > 0, build: buildCurves },
  images: {
    title: () => "Images",
    isAvailable: () => data.scenes.some((scene) => scene.truth.length),
    build: buildImages,
  },
  maps: { title: () => "Maps", isAvailable: () => Boolean(data.maps?.maps?.length), build: buildMaps },
  scenes: {
    title: () => "Scenes",
    isAvailable: () => data.scenes.filter((scene) => scene.truth.length).length > 1,
    build: buildScenes,
  },
  time: {
    title: () => "Time against error",
    isAvailable: () => Boolean(data.times.points),
    build: buildTime,
  },
  study: {
    title: () => STUDIES[data.suite_kind] ?? "Study",
    isAvailable: () => data.charts.length > 0,
    build: buildStudy,
  },
  rows: { title: () => "Rows", isAvailable: () => data.n > 0, build: buildRows },
};
