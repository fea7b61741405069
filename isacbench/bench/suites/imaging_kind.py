"""The kind ``imaging``: every scenario as it is, and its image scored."""

from isacbench.bench.suites.kind import STAGES, Kind, Tables

IMAGING = Kind(
    name="imaging",
    plan="isacbench.bench.studies.imaging_study:imaging_scenes",
    tables=Tables(
        "isacbench.bench.studies.imaging_study:summarise_scores",
        "isacbench.report.tables.run_tables:score_grids",
    ),
    timed_tables={
        "stages": STAGES,
        "pareto": Tables("isacbench.report.tables.pareto:summarise_times"),
        "budgets": Tables(
            "isacbench.report.tables.budgets:summarise_budgets",
            "isacbench.report.tables.budgets:budget_grids",
        ),
    },
    figures="isacbench.report.figures.run_figures:imaging_figures",
)
