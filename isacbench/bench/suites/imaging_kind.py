"""The kind ``imaging``: every scenario as it is, and its image scored."""

from isacbench.bench.suites.kind import OF_IMAGES, OF_TIMED_IMAGES, Kind, Tables

IMAGING = Kind(
    name="imaging",
    plan="isacbench.bench.studies.imaging_study:imaging_scenes",
    tables=Tables(
        "isacbench.bench.studies.imaging_study:summarise_scores",
        "isacbench.report.tables.image_tables:score_grids",
    ),
    metrics=OF_IMAGES,
    timed_tables=OF_TIMED_IMAGES,
    figures="isacbench.report.figures.run_figures:imaging_figures",
)
