"""Detect folders on a network, where SQLite's locks and shared memory are unreliable."""

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


def find_network_type(path: Path, mountinfo: str | None = None, *, mounts: Path = MOUNTS) -> str | None:
    """Detect the type of the network file system of a path, such as "nfs4"; None if local or unknown.

    Parameters
    ----------
    path
        File or folder; it need not exist yet.
    mountinfo
        Text of Linux's ``/proc/self/mountinfo`` (proc(5)); None reads ``mounts``.
    mounts
         Path of this machine's file; if it cannot be read, the type is unknown.

    Notes
    -----
    Works on Linux and Windows; on other systems the result is always None.
    """
    if mountinfo is None and sys.platform == "win32":
        return _detect_windows_drive(path)
    if mountinfo is None:
        try:
            mountinfo = mounts.read_text(encoding="utf-8", errors="surrogateescape")
        except OSError:
            # No such file on macOS and others: the type is unknown.
            return None
        path = path.resolve()
    kind = _find_filesystem_type(path.as_posix(), mountinfo)
    if kind in _NETWORK_TYPES or _NETWORK_FUSE.fullmatch(kind):
        return kind
    return None


def _find_filesystem_type(path: str, mountinfo: str) -> str:
    """Find the type of the file system mounted nearest above an absolute path; "" if there is none.

    Of several mounts on one point the last one counts; malformed lines of ``mountinfo`` are skipped.
    """
    place = PurePosixPath(path)
    nearest, kind = -1, ""
    for line in mountinfo.splitlines():
        mount, separator, filesystem = line.partition(" - ")
        fields = mount.split()
        if not separator or len(fields) < 5 or not filesystem.split():
            continue
        mount_point = PurePosixPath(re.sub(r"\\([0-7]{3})", lambda match: chr(int(match[1], 8)), fields[4]))
        # ">=": a later mount on the same point hides the earlier one.
        if place.is_relative_to(mount_point) and len(mount_point.parts) >= nearest:
            nearest, kind = len(mount_point.parts), filesystem.split()[0]
    return kind


def _detect_windows_drive(path: Path) -> str | None:
    """Return "UNC share" or "network drive" for a path on such a volume of Windows, else None."""
    if sys.platform != "win32":
        return None
    anchor = path.resolve().anchor
    if anchor.startswith("\\\\") and not anchor.startswith(("\\\\?\\", "\\\\.\\")):
        return "UNC share"
    if ctypes.windll.kernel32.GetDriveTypeW(anchor) == _WINDOWS_DRIVE_REMOTE:
        return "network drive"
    return None
