"""Draw the product spectrum of one cell of the street with its CFAR threshold, as the paper shows it.

python docs/scripts/product_spectrum.py
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from isacbench_algorithms import chain
from isacbench_algorithms.detectors import CaCfar
from isacbench_algorithms.music2d import PRODUCT_GUARD, PRODUCT_TRAINING, Music2d

from isacbench import load_scenario, observe
from isacbench.model.echo import echo_parameters
from isacbench.report.figures import THRESHOLD, new_figure, save, styled

FIGURE = Path(__file__).resolve().parents[1] / "images" / "product-spectrum.png"
SNR_DB = 10.0
NEAR_BINS = 1.5


def main() -> None:
    """Draw the cell with the most plane waves."""
    scenario = load_scenario("street")
    observation = observe(scenario, SNR_DB)
    estimator = Music2d(pairing="product")
    rdm = chain.read_map(observation, estimator)
    cells = chain.read_cells(rdm, chain.detect(rdm, estimator), estimator.snapshot_rules()[0])
    waves = estimator.plane_waves(observation, cells)
    k = int(waves.found.sum(axis=1).argmax())
    echo = echo_parameters(scenario)
    off_bins = np.maximum(abs(echo.range_bin - cells.bins[0][k]), abs(echo.doppler_bin - cells.bins[1][k]))
    near = off_bins < NEAR_BINS
    along_u, along_w = (
        estimator.line_music(*estimator.line_subspaces(lines[k : k + 1], cells.levels.floor), limits)
        for lines, limits in zip(
            estimator.aperture(observation).lines(cells.own), observation.cosine_limits, strict=True
        )
    )
    product = along_u.spectra[:, :, None] * along_w.spectra[:, None]
    threshold = CaCfar(estimator.product_pfa, PRODUCT_TRAINING, PRODUCT_GUARD).detect(product).threshold[0]
    power_db, threshold_db = 10 * np.log10(product[0]), 10 * np.log10(threshold)
    with styled():
        figure = new_figure(11.5, 4.8)
        surface, plane = figure.add_subplot(1, 2, 1, projection="3d"), figure.add_subplot(1, 2, 2)
        u, w = np.meshgrid(along_u.cosine, along_w.cosine, indexing="ij")
        surface.plot_surface(u, w, power_db, cmap="viridis", rcount=120, ccount=120, linewidth=0)
        surface.plot_wireframe(
            u, w, threshold_db, color=THRESHOLD, rcount=34, ccount=34, linewidth=0.5, alpha=0.8
        )
        surface.view_init(elev=22, azim=-68)
        surface.set(xlabel="u", ylabel="w", zlabel="level [dB]", title="product spectrum and its threshold")
        surface.locator_params(nbins=5)
        image = plane.pcolormesh(along_u.cosine, along_w.cosine, power_db.T, rasterized=True)
        figure.colorbar(image, ax=plane, label="level [dB]")
        above = (product[0] > threshold).T.astype(float)
        plane.contour(along_u.cosine, along_w.cosine, above, levels=[0.5], colors=THRESHOLD)
        plane.plot([], [], color=THRESHOLD, label="above the threshold")
        found = waves.found[k]
        marks = {"linestyle": "none", "color": "w"}
        plane.plot(waves.u[k][found], waves.w[k][found], "o", mfc="none", ms=9, label="plane waves", **marks)
        plane.plot(
            echo.u[near], echo.w[near], "x", ms=5, label=f"true scatterers within {NEAR_BINS} bins", **marks
        )
        plane.legend(loc="lower left", facecolor="0.35", labelcolor="w")
        range_m = cells.bins[0][k] * scenario.system.range_bin_m
        speed_mps = cells.bins[1][k] * scenario.system.velocity_bin_mps
        plane.set(xlabel="u", ylabel="w", title=f"the cell of {range_m:.1f} m and {speed_mps:.1f} m/s")
        save(figure, FIGURE)


if __name__ == "__main__":
    main()
