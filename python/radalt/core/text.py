"""Messages for users, on one line."""

import re

MOST = 300  # longest message, characters: four lines of a terminal
# the folders of an absolute path
_FOLDERS = re.compile(r"""(?<![\w.:/])(?:/[^\s/,;:"'()]+){2,}/""")


def one_line(text: str, most: int = MOST) -> str:
    """Printable, on one line, of at most ``most`` characters.

    A longer text loses the folders of paths first, then its middle: cause and remedy are at the ends.

    Examples
    --------
    >>> one_line("altimeter.window is 'wwwwwwwwwwww'; allowed: boxcar, hann", 40)
    'altimeter.window  ... wed: boxcar, hann'
    >>> one_line("/a/very/long/folder/file.py: no such key", 30)
    '.../file.py: no such key'
    """
    text = "".join(c if c.isprintable() else "?" for c in " ".join(text.split()))
    if len(text) <= most:
        return text
    text = _FOLDERS.sub(".../", text)
    if len(text) <= most:
        return text
    half = (most - 5) // 2
    return f"{text[:half]} ... {text[-half:]}"


def showable(text: object) -> bool:
    """Whether a text is short and safe in a page: printable, without markup, links and table delimiters."""
    short = isinstance(text, str) and len(text) <= MOST
    return short and text.isprintable() and not set("<>|") & set(text) and "](" not in text


def said(error: BaseException) -> str:
    """Message of an exception; an OSError gives file and reason, without its error number.

    Examples
    --------
    >>> said(FileExistsError(17, "File exists", "results"))
    'results: File exists; name another file or folder'
    """
    if isinstance(error, OSError) and error.strerror:
        return (
            f"{error.filename}: {error.strerror}; name another file or folder"
            if error.filename
            else error.strerror
        )
    return str(error).strip() or type(error).__name__
