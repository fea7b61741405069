"""The kind ``link``: one frame that is sensed with and received, bit errors compared with images."""

import math
from typing import Annotated, get_args

from pydantic import AfterValidator

from isacbench.bench.suites.kind import SNR_GAIN, Kind, Tables
from isacbench.bench.suites.suite import Listed, Suite, refuse_repeats
from isacbench.choices import Division, Modulation, Sensing


class LinkSuite(Suite):
    """Suite of the kind ``link``.

    Attributes
    ----------
    modulations : tuple of {"qpsk", "16qam", "64qam", "256qam"}
        Modulations of the data that are sent, received, and sensed with.
    sensing : tuple of {"all", "prs"}
        Resource elements that are sensed with.
    divisions : tuple of {"reciprocal", "matched", "wiener"}
        Divisions of the echo by symbols of unequal power.
    channels : tuple of str
        Channels to the user as ``name[param=value,...]``: ``awgn``,
        ``two_ray`` and ``tapped_delay``, see `isacbench.link.reception.channel`.
    receivers : tuple of str
        Receivers of the user, likewise: ``one_tap``, see `isacbench.bench.studies.link_reception.OneTap`.
    """

    kind: str = "link"
    modulations: Listed[Modulation] = get_args(Modulation)
    sensing: Listed[Sensing] = get_args(Sensing)
    divisions: Listed[Division] = get_args(Division)
    channels: Annotated[tuple[str, ...], AfterValidator(refuse_repeats)] = ("awgn", "two_ray", "tapped_delay")
    receivers: Listed[str] = ("one_tap[knowledge=perfect]", "one_tap")


LINK = Kind(
    name="link",
    suite=LinkSuite,
    columns={
        **SNR_GAIN,
        **dict.fromkeys(["template", "modulation", "sensing", "division", "channel"], ""),
        **dict.fromkeys(["n_bits", "n_bit_errors"], 0),
        **dict.fromkeys(["ber_expected", "evm_db", "channel_error_db", "rate_bps"], math.nan),
    },
    better={"rate_bps": "higher", **dict.fromkeys(["snr_gain_db", "n_bits", "ber_expected"], "neither")},
    plan="isacbench.bench.studies.link_study:link_scenes",
    tables=Tables(
        "isacbench.bench.studies.link_study:summarise_link",
        "isacbench.report.tables.link_tables:link_grids",
    ),
    figures="isacbench.report.figures.link_figures:link_figures",
)
