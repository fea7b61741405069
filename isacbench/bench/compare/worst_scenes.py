"""Scenes to look at: where an estimator does worst or changed most, and the command that shows an image."""

from __future__ import annotations

import shlex
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from isacbench.bench.compare.scene_scores import SCENE_CELL, VARIANT, scene_families
from isacbench.bench.compare.verdicts import ROUNDING
from isacbench.bench.store.manifest import scenario_texts
from isacbench.charts import rows_of, variants_in
from isacbench.specifications import parse_spec

if TYPE_CHECKING:
    from collections.abc import Mapping

    from isacbench.bench.compare.scene_scores import SceneScores
    from isacbench.charts import Variant

N_WORST = 3
"""Number of scenes that are listed for each estimator."""

N_CHANGED = 5
"""Number of scenes that are listed for each score of a comparison."""

PICTURE = "image.png"


def worst_scenes(
    records: pd.DataFrame, manifest: Mapping[str, Any], scored: SceneScores, better: str
) -> pd.DataFrame:
    """List the three scenes in which each estimator has its worst scores.

    The columns are ``estimator``, ``params``, ``scenario``, ``family``, ``score`` of the scene; of its worst
    cell ``snr_db``, ``trial``, ``cell_score`` and ``status``.
    """
    families, found = scene_families(manifest), []
    for variant in variants_in(scored.scenes.columns.to_frame()):
        own = rows_of(records, variant).astype({"scenario": object}).set_index(SCENE_CELL)
        scores = scored.scenes[variant].sort_values(ascending=better == "higher", kind="stable")
        cells = own[["status"]].join(scored.cells[variant].rename("cell_score"), how="inner").reset_index()
        cells = cells.sort_values("cell_score", ascending=better == "higher", kind="stable")
        worst = cells.drop_duplicates("scenario").set_index("scenario").loc[scores.index[:N_WORST]]
        found.append(
            worst.reset_index().assign(
                estimator=variant[0],
                params=variant[1],
                family=[families.get(str(scene), "") for scene in worst.index],
                score=scores.to_numpy()[: len(worst)],
            )
        )
    columns = [*VARIANT, "scenario", "family", "score", "snr_db", "trial", "cell_score", "status"]
    return pd.concat(found, ignore_index=True)[columns]


def most_changed(
    pairs: pd.DataFrame,
    metric: str,
    manifest: Mapping[str, Any],
    partners: Mapping[Variant, Variant],
    labels: Mapping[Variant, str],
) -> pd.DataFrame:
    """List the scenes in which a score changed most.

    Parameters
    ----------
    pairs : DataFrame
        As `isacbench.bench.compare.matching.pair_cells` returns it.
    manifest : mapping of str to Any
        Of the new run.
    partners : mapping of (str, str) to (str, str)
        Variant of the new run for those of the base that have another name or other parameters.
    labels : mapping of (str, str) to str
        Names of estimators, which are specifications.

    Returns
    -------
    DataFrame
        At most five rows, the largest mean change of a scene first: ``metric``,
        ``scenario``, ``family``, ``estimator``, ``params``, means ``base`` and
        ``new``, ``change``; of the cell that changed most ``snr_db``,
        ``trial``, and ``command``, which shows it in the new run.
    """
    keys, families = ["scenario", "estimator", "params"], scene_families(manifest)
    rows = pairs[[*keys, "snr_db", "trial"]].assign(
        base=pairs[f"{metric}_base"].astype(float), new=pairs[f"{metric}_new"].astype(float)
    )
    rows["change"] = rows["new"] - rows["base"]
    rows = rows[np.isfinite(rows["change"])]
    means = rows.groupby(keys, sort=False)[["base", "new", "change"]].mean().reset_index()
    means = means[means["change"].abs() > ROUNDING * (means["base"].abs() + means["new"].abs())]
    chosen = means.loc[means["change"].abs().sort_values(ascending=False, kind="stable").index[:N_CHANGED]]
    found = []
    for row in chosen.to_dict("records"):
        cells = rows[(rows[keys] == [row[key] for key in keys]).all(axis=1)]
        cell = cells.loc[cells["change"].abs().idxmax()]
        variant = (row["estimator"], row["params"])
        label = labels[partners.get(variant, variant)]
        shown = command_to_show(manifest, row["scenario"], label, cell["snr_db"], cell["trial"])
        place = {"snr_db": cell["snr_db"], "trial": cell["trial"], "command": shown}
        found.append({"metric": metric, **row, "family": families.get(row["scenario"], ""), **place})
    columns = [
        "metric",
        "scenario",
        "family",
        *keys[1:],
        "base",
        "new",
        "change",
        "snr_db",
        "trial",
        "command",
    ]
    return pd.DataFrame(found, columns=columns)


def command_to_show(
    manifest: Mapping[str, Any],
    scenario: str,
    estimator: str,
    snr_db: float,
    trial: int,
    picture: str = PICTURE,
) -> str:
    """Spell the command that takes the image of a cell and draws it.

    Parameters
    ----------
    scenario : str
        Its name. It is spelled as in the suite, and plugin files as when the run was made.
    estimator : str
        Specification.
    picture : str
        File to draw into; empty for none.

    Returns
    -------
    str
        Empty for a scene that only the study of the run makes, and where there is no manifest.

    Examples
    --------
    >>> run = {"seed": 0, "scenarios": {"town": {}}, "suite": {"scenarios": ["made/town.toml"]}}
    >>> command_to_show(run, "town", "music2d", 10.0, 0)
    'isacbench image -s made/town.toml -e music2d --snr 10 --plot image.png'
    """
    text = scenario_texts(manifest).get(scenario) if manifest else None
    if text is None:
        return ""
    words = ["isacbench", "image", "-s", text, "-e", estimator, "--snr", f"{snr_db:.10g}"]
    numbers = {"--trial": int(trial), "--seed": int(manifest["seed"])}
    words += [word for name, number in numbers.items() if number for word in (name, str(number))]
    words += [word for path in _plugin_files(manifest, estimator) for word in ("--plugin", path)]
    return shlex.join([*words, *(["--plot", picture] if picture else [])])


def _plugin_files(manifest: Mapping[str, Any], estimator: str) -> list[str]:
    """Paths of the plugin files that an estimator and its parts come from."""
    paths: dict[str, str] = {}
    for session in manifest.get("sessions", ()):
        paths |= session.get("plugins", {})
    name = parse_spec(estimator).name
    entries = (one for one in manifest.get("estimators", ()) if one["name"] == name)
    return [
        paths[file]
        for file in dict.fromkeys(file for one in entries for file in one["packages"])
        if file in paths
    ]
