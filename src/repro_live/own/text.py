"""Text files of the recordings: read so that damage is said with file and place."""

from __future__ import annotations

from pathlib import Path

from repro.errors import bad_input


def read_text(path: Path) -> str:
    """Return the content of a text file in UTF-8, without a byte order mark.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    InputError
        Bytes that are no text.
    """
    content = path.read_bytes()
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        seen = f"byte 0x{content[error.start]:02x} at {error.start}"
        raise bad_input("content", path.name, "text in UTF-8", seen) from error
    if "\0" in text:
        raise bad_input("content", path.name, "text in UTF-8", f"a zero byte at {text.index(chr(0))}")
    return text
