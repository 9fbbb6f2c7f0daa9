"""Files written whole or not at all, and private. Those that users name overwrite nothing unasked, follow no links, and are
nameless until they are finished, where the system can do that.
"""

from __future__ import annotations

import errno
import io
import os
import secrets
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from consensus.errors import BlockRobotError

SMALL_FILE_MAX_BYTES = 64 * 1024
"""A key, words, a passphrase, a UID, a text of some pages."""
_DESCRIPTORS = Path("/proc/self/fd")
_PRIVATE, _PRIVATE_FOLDER, _PUBLIC = 0o600, 0o700, 0o644


def read_given_file(path: Path, max_bytes: int) -> bytes:
    """Raises FILE_UNUSABLE if too large, OSError."""
    with path.open("rb") as file:
        data = file.read(max_bytes + 1)
    if len(data) > max_bytes:
        raise BlockRobotError("FILE_UNUSABLE", f"{path} is larger than {max_bytes} bytes.")
    return data


def read_given_text(path: Path, max_bytes: int = SMALL_FILE_MAX_BYTES, *, encoding: str = "utf-8") -> str:
    """With line feeds as ends of lines. Raises FILE_UNUSABLE if too large or no text, OSError."""
    data = read_given_file(path, max_bytes)
    try:
        return io.StringIO(data.decode(encoding), newline=None).read()
    except UnicodeDecodeError:
        raise BlockRobotError("FILE_UNUSABLE", f"{path} is not a text file in {encoding}.") from None


def require_seen(folder: Path, name: str, child: str | None = None) -> None:
    """Raise PermissionError where that hides a file of this name in `folder`'s child, else in any: it looks missing."""
    with suppress(FileNotFoundError, NotADirectoryError):
        for place in (folder / child,) if child else sorted(folder.iterdir()):
            with suppress(FileNotFoundError, NotADirectoryError):
                (place / name).stat()


def require_free(path: Path, *, replace: bool = False, hint: str = "") -> None:
    """Raise FILE_EXISTS or FILE_UNUSABLE unless free or a replaceable plain file."""
    if path.is_symlink() or (path.exists() and (not replace or not path.is_file())):
        raise BlockRobotError("FILE_EXISTS", f"{path} is there already; nothing was written.{hint}")
    if not path.parent.is_dir():
        raise BlockRobotError("FILE_UNUSABLE", f"There is no folder {path.parent}.")


def require_own_folder(folder: Path) -> None:
    """Make it, private, if it is not there. Raise FILE_EXISTS for a link or a file: what lies behind it is somebody's."""
    if folder.is_symlink() or (folder.exists() and not folder.is_dir()):
        raise BlockRobotError("FILE_EXISTS", f"{folder} is a link or a file, and no folder: it was left as it is.")
    folder.mkdir(parents=True, exist_ok=True, mode=_PRIVATE_FOLDER)


def write_new_file(path: Path, data: bytes | str, *, private: bool = True, replace: bool = False) -> None:
    """Raises as `new_file`."""
    with new_file(path, private=private, replace=replace) as file:
        file.write(data.encode() if isinstance(data, str) else data)


@contextmanager
def new_file(path: Path, *, private: bool = True, replace: bool = False) -> Iterator[BinaryIO]:
    """Open a file named only on success. Raises FILE_EXISTS, FILE_UNUSABLE, OSError."""
    require_free(path, replace=replace)
    temporary = temporary_beside(path)
    file, place = create_nameless(temporary, _PRIVATE if private else _PUBLIC)
    try:
        with file:
            yield file
            finish(file, place, temporary)
        give_name(temporary, path, replace=replace)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


def temporary_beside(path: Path) -> Path:
    return path.with_name(f".{path.name[:64]}.{secrets.token_hex(4)}")


def create_nameless(temporary: Path, mode: int = _PRIVATE) -> tuple[BinaryIO, Path]:
    """Return the file (nameless if supported) and its readable path."""
    nameless = getattr(os, "O_TMPFILE", 0) if _DESCRIPTORS.exists() else 0
    try:
        descriptor = os.open(temporary.parent, os.O_RDWR | nameless, mode)
    except OSError:
        # Without O_TMPFILE this asks to write to a folder, which every system refuses.
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW
        return os.fdopen(os.open(temporary, flags, mode), "wb"), temporary
    return os.fdopen(descriptor, "wb"), Path(_DESCRIPTORS, str(descriptor))


def finish(file: BinaryIO, place: Path, temporary: Path) -> None:
    file.flush()
    os.fsync(file.fileno())
    if place != temporary:
        # With a descriptor named, Python asks the system so that it follows the link to the nameless file.
        os.link(place, temporary, src_dir_fd=file.fileno(), follow_symlinks=True)


def give_name(temporary: Path, path: Path, *, replace: bool) -> None:
    """Atomic; without `replace`, existing files stay."""
    if replace:
        temporary.replace(path)
    else:
        try:
            path.hardlink_to(temporary)
        except FileExistsError:
            raise BlockRobotError("FILE_EXISTS", f"{path} appeared meanwhile; nothing was written.") from None
        except OSError:
            # A file system without hard links: look once more, then rename.
            require_free(path)
            temporary.replace(path)
        temporary.unlink(missing_ok=True)
    sync_folder(path.parent)


def sync_folder(folder: Path) -> None:
    """So that renames and removals survive power loss."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def replace_file(path: Path, data: bytes, mode: int = _PRIVATE, *, temporary: Path | None = None) -> None:
    """Replace a program's own file: a crash or a power cut leaves the old one or the new one. Raises OSError."""
    temporary = temporary or temporary_beside(path)
    try:
        descriptor = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_NOFOLLOW, mode)
        with os.fdopen(descriptor, "wb") as file:
            os.fchmod(descriptor, mode)  # a leftover of a crash keeps its old mode
            file.write(data)
            file.flush()
            os.fsync(descriptor)
        temporary.replace(path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
    sync_folder(path.parent)


def open_to_append(path: Path) -> BinaryIO:
    """To read and append, private. Raises FILE_EXISTS for a link, another's or no plain file, OSError."""
    return os.fdopen(_open_own(path, os.O_RDWR | os.O_APPEND), "a+b")


def _open_own(path: Path, access: int) -> int:
    # without O_NONBLOCK, a pipe that somebody laid there would be waited for
    flags = access | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK
    foreign = BlockRobotError("FILE_EXISTS", f"{path} is a link, another user's file, or no plain file.")
    try:
        descriptor = os.open(path, flags, _PRIVATE)
    except OSError as error:
        if error.errno == errno.ENXIO or path.is_symlink():
            raise foreign from None
        raise
    try:
        found = os.fstat(descriptor)
        if not stat.S_ISREG(found.st_mode) or found.st_uid != os.geteuid() or found.st_nlink > 1:
            raise foreign
        os.fchmod(descriptor, _PRIVATE)  # one of an earlier time may be open to others
    except BaseException:
        os.close(descriptor)
        raise
    return descriptor


def write_private(path: Path, data: bytes | str) -> None:
    """Overwrite a reproducible file, without syncing it. Raises as `open_to_append`."""
    with os.fdopen(_open_own(path, os.O_WRONLY), "wb") as file:
        file.truncate()
        file.write(data.encode() if isinstance(data, str) else data)
