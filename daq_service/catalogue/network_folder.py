"""Tell whether a folder is on a network, where SQLite's locks and shared memory cannot be trusted."""

from __future__ import annotations

import ctypes
import re
import sys
from pathlib import Path, PurePosixPath

# Linux names of file systems whose storage, and so whose locks, belong to another machine.
_NETWORK_TYPES = frozenset(
    {
        "9p", "afs", "beegfs", "ceph", "cifs", "coda", "davfs", "gfs", "gfs2", "glusterfs", "gpfs", "lustre",
        "ncpfs", "nfs", "nfs4", "ocfs2", "orangefs", "prl_fs", "pvfs2", "smb2", "smb3", "smbfs", "vboxsf",
        "vmhgfs",
    }
)  # fmt: skip
_NETWORK_FUSE = re.compile(
    r"fuse\.(.*(sshfs|rclone|s3fs|gcsfuse|glusterfs|ceph|davfs|smb|nfs|cifs|vmhgfs|gvfsd).*)"
)
_WINDOWS_DRIVE_REMOTE = 4
MOUNTS = Path("/proc/self/mountinfo")


def network_filesystem(path: Path, mountinfo: str | None = None, *, mounts: Path = MOUNTS) -> str | None:
    """Type of the network file system that holds ``path``, or None where it is local or cannot be told.

    Parameters
    ----------
    path
        File or folder; it need not exist yet.
    mountinfo
        Text of Linux's ``/proc/self/mountinfo`` (proc(5)); None reads ``mounts``.
    mounts
        Where this machine's is.

    Notes
    -----
    Linux and Windows can tell; on other systems the answer is always None.
    """
    if mountinfo is None and sys.platform == "win32":
        return _windows_network_drive(path)
    if mountinfo is None:
        try:
            mountinfo = mounts.read_text(encoding="utf-8", errors="surrogateescape")
        except OSError:
            # No such file on macOS and others: it cannot be told.
            return None
        path = path.resolve()
    kind = _filesystem_type(path.as_posix(), mountinfo)
    if kind in _NETWORK_TYPES or _NETWORK_FUSE.fullmatch(kind):
        return kind
    return None


def _filesystem_type(path: str, mountinfo: str) -> str:
    """Type of the last mounted file system whose mount point is nearest above ``path``."""
    place = PurePosixPath(path)
    nearest, kind = -1, ""
    for line in mountinfo.splitlines():
        left, separator, right = line.partition(" - ")
        fields = left.split()
        if not separator or len(fields) < 5 or not right.split():
            continue
        mount_point = PurePosixPath(_unescape(fields[4]))
        # ">=": a later mount on the same point hides the earlier one.
        if place.is_relative_to(mount_point) and len(mount_point.parts) >= nearest:
            nearest, kind = len(mount_point.parts), right.split()[0]
    return kind


def _unescape(text: str) -> str:
    r"""Blank, tab, newline and backslash are written as ``\040`` and the like."""
    return re.sub(r"\\([0-7]{3})", lambda match: chr(int(match[1], 8)), text)


def _windows_network_drive(path: Path) -> str | None:
    if sys.platform != "win32":
        return None
    anchor = path.resolve().anchor
    if anchor.startswith("\\\\") and not anchor.startswith(("\\\\?\\", "\\\\.\\")):
        return "UNC share"
    if ctypes.windll.kernel32.GetDriveTypeW(anchor) == _WINDOWS_DRIVE_REMOTE:
        return "network drive"
    return None
