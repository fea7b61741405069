"""A case with a part of its promises."""

import dataclasses


def narrowed(case, keep):
    """The case with its first promise, and of the others those that are kept."""

    class Narrow(type(case)):
        @property
        def promises(self):
            first, *others = super().promises
            return (first, *filter(keep, others))

    return Narrow(**dataclasses.asdict(case))
