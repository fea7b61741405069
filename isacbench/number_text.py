"""Numbers in text from outside, as files and the command line spell them."""


def is_number(text: str) -> bool:
    """Tell if a text is a number, NaN and infinity included, without ``_`` and digits of other scripts.

    Parameters
    ----------
    text : str

    Returns
    -------
    bool
        False for ``1_0`` and ``１``, which `float` takes.
    """
    try:
        float(text)
    except ValueError:
        return False
    return text.isascii() and "_" not in text
