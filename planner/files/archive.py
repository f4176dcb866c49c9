"""Members of zip archives, read only up to their declared size, because 8 MB can hold 8 GB of zeros."""

import zipfile


def read_member(archive: zipfile.ZipFile, name: str, max_bytes: int) -> bytes:
    """Return the bytes of an archive's member.

    Raises:
        ValueError: when it declares more bytes than `max_bytes`, or holds another number of bytes than it declares.
    """
    declared = archive.getinfo(name).file_size
    if declared > max_bytes:
        raise ValueError(f"{name} would take {declared} bytes; at most {max_bytes} are read")
    with archive.open(name) as file:
        content = file.read(declared)
    if len(content) != declared:
        raise ValueError(f"{name} holds {len(content)} bytes and declares {declared}")
    return content
