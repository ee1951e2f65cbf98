"""Detection of network folders from the mount list of Linux."""

import sys
from pathlib import Path

import pytest

from daq_service.catalogue.network_folder import find_network_type

# proc(5): id, parent, device, root, mount point, options, optional fields, -, type, source, options.
MOUNTINFO = r"""
22 1 259:2 / / rw,relatime shared:1 - ext4 /dev/nvme0n1p2 rw
30 22 0:50 / /home/lab/nfs rw,relatime shared:2 master:7 - nfs4 server:/export rw,vers=4.2
31 30 259:3 / /home/lab/nfs/local rw,relatime - xfs /dev/nvme1n1 rw
32 22 0:51 / /mnt/with\040blank rw - cifs //server/share rw
33 22 0:52 / /mnt/ssh rw - fuse.sshfs user@host: rw
34 22 0:53 / /mnt/c rw - 9p C:\134 rw
35 22 0:54 / /mnt/stick rw - fuseblk /dev/sdb1 rw
36 22 0:55 / /mnt/twice rw - nfs4 server:/old rw
37 22 259:4 / /mnt/twice rw - ext4 /dev/sdc1 rw
38 22 0:56 / /mnt/hidden rw - ext4 /dev/sdd1 rw
39 22 0:57 / /mnt/hidden rw - smb3 //server/over rw
40 22 0:58 / /mnt/bucket rw - fuse.s3fs s3fs rw
41 22 0:59 / /tmp rw - tmpfs tmpfs rw
garbled line
"""


@pytest.mark.parametrize(
    ("path", "kind"),
    [
        ("/data/solimon", None),
        ("/home/lab/nfs", "nfs4"),
        ("/home/lab/nfs/deep/er", "nfs4"),
        ("/home/lab/nfs/local/data", None),
        ("/home/lab/nfs-not", None),
        ("/mnt/with blank/data", "cifs"),
        ("/mnt/ssh/data", "fuse.sshfs"),
        ("/mnt/c/Users/me", "9p"),
        ("/mnt/stick/data", None),
        ("/mnt/twice/data", None),
        ("/mnt/hidden/data", "smb3"),
        ("/mnt/bucket/data", "fuse.s3fs"),
        ("/tmp/data", None),
    ],
)
def test_the_nearest_and_newest_mount_decides(path, kind):
    assert find_network_type(Path(path), MOUNTINFO) == kind


def test_without_mounts_the_filesystem_is_unknown():
    assert find_network_type(Path("/data"), "") is None


def test_this_machines_temporary_folder_is_local(tmp_path):
    assert find_network_type(tmp_path / "not" / "there" / "yet") is None


def test_without_a_mount_list_the_filesystem_is_unknown(tmp_path):
    assert find_network_type(tmp_path, mounts=tmp_path / "absent") is None


def test_a_link_into_the_network_is_followed(tmp_path):
    (tmp_path / "far").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "far")
    mounts = tmp_path / "mountinfo"
    far = str((tmp_path / "far").resolve()).replace(" ", r"\040")
    mounts.write_text(f"1 0 8:1 / / rw - ext4 /dev/sda1 rw\n2 1 0:9 / {far} rw - nfs server:/x rw\n")
    assert find_network_type(tmp_path / "link" / "data", mounts=mounts) == "nfs"
    assert find_network_type(tmp_path / "other", mounts=mounts) is None


@pytest.mark.skipif(sys.platform != "win32", reason="asks Windows itself")
def test_windows_distinguishes_shares_and_drives(tmp_path):
    assert find_network_type(tmp_path) is None
    assert find_network_type(Path(r"\\server\share\data")) == "UNC share"
