"""A case with a part of its checks."""

import dataclasses


def narrowed(case, keep):
    """The case with its first check, and of the others those that are kept."""

    def make(*args):
        subject, (first, *others) = case.family.make(*args)
        return subject, (first, *filter(keep, others))

    return dataclasses.replace(case, family=dataclasses.replace(case.family, make=make))
