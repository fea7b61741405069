/* Maps. */

const buildMaps = (root) => {
  const own = data.maps.maps,
    names = own.map((one) => [`${one.scene}|${one.estimator}`, `${one.scene}, ${one.estimator}`]);
  root.append(controls(selectControl("map", "Map of", names)));
  root.append(
    note(
      `Computed anew when this page was made, at ${own[0].snr_db} dB, trial ${own[0].trial}.${data.maps.left_out ? ` It leaves out ${counted(data.maps.left_out, "further image")}; isacbench report DIR --scenario SCENARIO --snr DB draws one.` : ""}`,
    ),
  );
  const figures = ["Power", "Threshold", "Power where detected"].map(
    (title) => new Figure({ title, label: `${title} of the range-Doppler map`, height: 420 }),
  );
  const spectra = h("div", { class: "grid" }),
    grid = h("div", { class: "grid" }, figures.map((figure) => figure.element));
  root.append(grid, heading("Angular spectra of the strongest cell"), spectra);
  return () => {
    const map = own.find((one) => `${one.scene}|${one.estimator}` === state.map) ?? own[0];
    const detected = map.power_db.map((row, i) => row.map((one, j) => (map.mask[i][j] ? one : null)));
    const all = map.power_db.flat();
    const [low, high] = extent([...all, ...map.threshold_db.flat()].filter((one) => one !== null));
    [map.power_db, map.threshold_db, detected].forEach((z, i) => {
      const columns = ["range [m]", "velocity [m/s]", "dB over noise"].map((title, at) => ({ title, get: (row) => row[at] }));
      const cells = map.range_m
        .flatMap((range, a) => map.velocity_mps.map((speed, b) => [range, speed, z[a][b]]))
        .filter((row) => row[2] !== null);
      const caption = figures[i].heading.textContent;
      figures[i].table = () => dataTable({ caption, name: "map", columns, rows: cells, first: "dB over noise|down" });
      figures[i].note.textContent =
        `${short(map.scene)}, ${short(map.estimator)}${i === 2 ? `: ${counted(cells.length, "cell")} of ${all.length}` : ""}`;
      figures[i].draw(
        [
          {
            type: "heatmap",
            x: map.velocity_mps,
            y: map.range_m,
            z,
            zmin: low,
            zmax: high,
            colorscale: "Cividis",
            colorbar: { title: { text: "dB over noise", side: "right" }, thickness: 12, outlinewidth: 0 },
            hovertemplate: "%{y} m, %{x} m/s: %{z} dB<extra></extra>",
          },
        ],
        { xaxis: axis({ title: { text: "radial velocity [m/s]" } }), yaxis: axis({ title: { text: "range [m]" } }) },
      );
    });
    spectra.replaceChildren(map.spectra.length ? "" : "Nothing was detected.");
    for (const one of map.spectra) {
      const title = `Spectrum along ${one.label}`,
        table = seriesTable(title, one.label, "dB", [{ label: "level", x: one.cosine, y: one.level_db }]),
        figure = new Figure({ title, label: `Angular spectrum along ${one.label}`, height: 320, table });
      spectra.append(figure.element);
      const level = (cosine) => one.level_db[one.cosine.indexOf(nearTo(one.cosine, cosine))];
      const traces = [
        ...lineWithBand({ label: "spectrum", x: one.cosine, y: one.level_db }, { colour: css("found"), dash: "solid" }),
        ...(one.threshold_db
          ? lineWithBand({ label: "threshold", x: one.cosine, y: one.threshold_db }, { colour: css("false"), dash: "dash" })
          : []),
        ...lineWithBand({ label: "peaks", x: one.peaks, y: one.peaks.map(level) }, { colour: css("fg"), symbol: "triangle-down" }),
      ];
      figure.draw(traces, {
        xaxis: axis({ title: { text: `direction cosine ${one.label}` } }),
        yaxis: axis({ title: { text: "level [dB]" } }),
      });
    }
  };
};
