"""Draw two scenes of every family from above into docs/images/scene-families.png; what is hidden is grey.

python docs/scripts/scene_families.py
"""

from __future__ import annotations

from pathlib import Path

from matplotlib.axes import Axes

from isacbench import load_scenario
from isacbench.model.scenes.scene_families import FAMILIES
from isacbench.report.clouds import velocity_colours
from isacbench.report.figures import new_figure, save, styled

FIGURE = Path(__file__).resolve().parents[1] / "images" / "scene-families.png"
SEEDS = 0, 2
FASTEST_MPS = 12.0
COLUMNS = 4


def draw_scene(axes: Axes, name: str) -> None:
    """Draw the scatterers of a scene from above, coloured by their radial velocity if they are seen.

    Parameters
    ----------
    axes : Axes
    name : str
        Of the scenario, up to the parameter ``visible``.
    """
    everything = load_scenario(f"{name},visible=all]").scatterers
    scenario = load_scenario(f"{name},visible=seen]")
    scatterers, region = scenario.scatterers, scenario.region
    colours = velocity_colours(FASTEST_MPS)
    axes.scatter(*everything.xyz[:, :2].T, c="lightgray", s=5, linewidths=0)
    x, y, _ = scatterers.xyz.T
    axes.scatter(x, y, c=colours.to_rgba(scatterers.velocity), s=5, linewidths=0)
    axes.set(title=f"{name}]", xlim=region.x_m, ylim=region.y_m, aspect="equal")


def main() -> None:
    """Draw and save."""
    with styled():
        scenes = [f"{family}[seed={seed}" for family in FAMILIES for seed in SEEDS]
        figure = new_figure(14, 11)
        panels = figure.subplots(-(-len(scenes) // COLUMNS), COLUMNS, sharex=True, sharey=True)
        for axes, name in zip(panels.flat, scenes, strict=True):
            draw_scene(axes, name)
        for axes in panels[-1]:
            axes.set_xlabel("x [m]")
        for axes in panels[:, 0]:
            axes.set_ylabel("y [m]")
        bar = figure.colorbar(velocity_colours(FASTEST_MPS), ax=panels)
        bar.set_label("radial velocity [m/s], approaching > 0")
        save(figure, FIGURE)


if __name__ == "__main__":
    main()
