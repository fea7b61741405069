"""Scenes to look at: where an estimator does worst, and the command that shows its image there."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd

from isacbench.bench.compare.scene_scores import SCENE_CELL, scene_families
from isacbench.bench.plan.labels import rows_of

if TYPE_CHECKING:
    from collections.abc import Mapping

    from isacbench.bench.compare.scene_scores import SceneScores
    from isacbench.bench.plan.labels import Variant

N_WORST = 3
"""Number of scenes that are listed for each estimator."""

PICTURE = "image.png"


def worst_scenes(
    records: pd.DataFrame,
    manifest: Mapping[str, Any],
    scored: SceneScores,
    better: str,
    labels: Mapping[Variant, str],
) -> pd.DataFrame:
    """List the scenes in which each estimator has its worst scores.

    Parameters
    ----------
    records : DataFrame
        Rows of the run.
    manifest : mapping of str to Any
    scored : SceneScores
    better : {"lower", "higher"}
    labels : mapping of (str, str) to str
        Names of estimators, which are specifications.

    Returns
    -------
    DataFrame
        A row for each of three scenes of each estimator: ``estimator``,
        ``params``, ``scenario``, ``family``, ``score`` of the scene; of its worst
        cell ``snr_db``, ``trial``, ``cell_score``, ``status``, and ``precision``
        and ``recall`` where the run has them; ``command``, which shows the cell.
    """
    families, found = scene_families(manifest), []
    shares = [name for name in ("precision", "recall") if name in records]
    for variant in scored.scenes.columns:
        own = rows_of(records, variant).astype({"scenario": object}).set_index(SCENE_CELL)
        scores, cells = scored.scenes[variant], scored.cells[variant]
        for scene in scores.sort_values(ascending=better == "higher", kind="stable").index[:N_WORST]:
            of_scene = cells.loc[[scene]]
            place = of_scene.idxmax() if better == "lower" else of_scene.idxmin()
            row, (_, snr_db, trial) = own.loc[place], place
            found.append(
                {
                    "estimator": variant[0],
                    "params": variant[1],
                    "scenario": scene,
                    "family": families.get(scene, ""),
                    "score": scores[scene],
                    "snr_db": snr_db,
                    "trial": trial,
                    "cell_score": cells[place],
                    "status": row["status"],
                    **{name: row[name] for name in shares},
                    "command": command_to_show(manifest, scene, labels[variant], snr_db, trial),
                }
            )
    return pd.DataFrame(found)


def command_to_show(
    manifest: Mapping[str, Any], scenario: str, estimator: str, snr_db: float, trial: int
) -> str:
    """Spell the command that takes the image of a cell and draws it.

    Parameters
    ----------
    manifest : mapping of str to Any
    scenario : str
        Its name. The path of its file stands for it where the suite names one.
    estimator : str
        Specification.
    snr_db : float
    trial : int

    Returns
    -------
    str

    Examples
    --------
    >>> command_to_show({"seed": 0}, "town[seed=7]", "music2d", 10.0, 0)
    "isacbench image -s 'town[seed=7]' -e music2d --snr 10 --plot image.png"
    """
    paths = {Path(name).stem: name for name in manifest.get("suite", {}).get("scenarios", ())}
    numbers = {"--trial": int(trial), "--seed": int(manifest["seed"])}
    words = ["isacbench", "image", "-s", paths.get(scenario, scenario), "-e", estimator]
    words += ["--snr", f"{snr_db:.10g}"]
    words += [word for name, number in numbers.items() if number for word in (name, str(number))]
    return shlex.join([*words, "--plot", PICTURE])
