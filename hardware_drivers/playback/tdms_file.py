"""The only module that imports npTDMS: a file's channels, and their raw values."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hardware_drivers.errors import ConfigurationError
from hardware_drivers.playback.tdms_channel import Channel

if TYPE_CHECKING:
    from nptdms import TdmsChannel, TdmsFile, TdmsGroup
    from nptdms.tdms import ChannelSegmentStatus

_BRING_BACK = "bring the file back from a copy, or take it away: its shots are missed strikes then"

_LEAD_IN_BYTES = 28
_BIG_ENDIAN = 1 << 6
_UNFINISHED = 0xFFFF_FFFF_FFFF_FFFF


def require_nptdms() -> None:
    """Raise ConfigurationError, with a hint for installation, if npTDMS cannot be imported."""
    try:
        import nptdms  # noqa: F401
    except ImportError as error:
        raise ConfigurationError(
            "LabVIEW files need npTDMS, which is not installed; pip install 'solimon[tdms]'"
        ) from error


def read_channels(path: Path, wanted: Callable[[str, str], bool]) -> list[Channel]:
    """Read the metadata of the channels that ``wanted(group, name)`` accepts, in file order.

    ``wanted`` is called once per channel of the file. Channels without values are left out.

    Raises
    ------
    ConfigurationError
        The file cannot be read or is damaged, or a wanted channel is cut short.
    """
    with _translate_errors(path), _open_file(path) as file:
        statuses = file.file_status.channel_statuses or {}
        found = []
        for group in file.groups():
            for channel in group.channels():
                if wanted(group.name, channel.name):
                    _require_complete_values(path, channel, statuses)
                    if len(channel):
                        found.append(_describe_channel(path, file, group, channel))
        _require_complete_end(path)
    return found


class ValuesReader:
    """Reader of values; keeps the last file open."""

    def __init__(self) -> None:
        """Start without an open file."""
        self._open: tuple[Path, TdmsFile] | None = None
        self._closing = ExitStack()

    def read(self, path: Path, group: str, name: str, first: int, n_samples: int) -> NDArray[np.generic]:
        """Read unscaled values of a channel from sample ``first`` on, shape (n_samples,); fewer at its end.

        The file stays open until another one is read.

        Raises
        ------
        ConfigurationError
            The file is gone or damaged, or has no such channel.
        """
        with _translate_errors(path):
            if self._open is None or self._open[0] != path:
                self.close()
                self._open = (path, self._closing.enter_context(_open_file(path)))
            return _read_raw_values(self._open[1][group][name], first, n_samples)

    def close(self) -> None:
        """Close the open file, if any; a later `read` opens it again."""
        self._open = None
        self._closing.close()


@contextmanager
def _open_file(path: Path) -> Iterator[TdmsFile]:
    """Open a TDMS file with raw time stamps and without an index file; yield it, and close it on exit.

    Errors of the file and of npTDMS pass through.
    """
    import nptdms

    with path.open("rb") as file:
        # Raw time stamps have 2^-64 s, npTDMS's own conversion a microsecond.
        yield nptdms.TdmsFile.open(file, raw_timestamps=True)


def _describe_channel(path: Path, file: TdmsFile, group: TdmsGroup, channel: TdmsChannel) -> Channel:
    """Build the description of a channel from its metadata and one value, which shows the type of raw values.

    Errors of npTDMS pass through.
    """
    return Channel(
        path=path,
        group=group.name,
        name=channel.name,
        own_properties=channel.properties,
        group_properties=group.properties,
        file_properties=file.properties,
        # One sample shows the type of DAQmx raw data too, which hide it in their scaler.
        dtype=_read_raw_values(channel, 0, 1).dtype.newbyteorder("="),
        n_samples=len(channel),
    )


def _read_raw_values(channel: TdmsChannel, first: int, n_samples: int) -> NDArray[np.generic]:
    """Read ``n_samples`` unscaled values from sample ``first`` on, 1-D; fewer at the channel's end.

    Raise ConfigurationError if the channel has several DAQmx scalers; errors of npTDMS pass through.
    """
    values = channel.read_data(offset=first, length=n_samples, scaled=False)
    if isinstance(values, dict):
        if len(values) != 1:
            raise ConfigurationError(
                f"channel {channel.path} has {len(values)} DAQmx scalers; write each channel by itself"
            )
        values = next(iter(values.values()))
    return np.asarray(values)


def _require_complete_values(
    path: Path, channel: TdmsChannel, statuses: Mapping[str, ChannelSegmentStatus]
) -> None:
    """Raise ConfigurationError if values of a channel are missing at the end of its last segment.

    npTDMS fills them with zeros or omits them; only its status, in ``statuses`` by path, shows that.
    """
    status = statuses.get(channel.path)
    if status is not None and status.read_length < status.expected_length:
        raise ConfigurationError(
            f"{path}, channel {channel.path}: cut short, {status.read_length} of the last "
            f"{status.expected_length} samples are left; {_BRING_BACK}"
        )


def _require_complete_end(path: Path) -> None:
    """Raise ConfigurationError unless the file ends at the end of a segment.

    npTDMS takes a cut last segment for the end of the file, and shots would vanish. A writer that crashed
    (length unknown) is accepted.

    A segment starts with 28 bytes: tag, flags (bit 6: big-endian), version, length of the rest, and length of
    its metadata (NI: "TDMS file format internal structure").
    """
    position, n_bytes = 0, path.stat().st_size
    with path.open("rb") as file:
        while position < n_bytes:
            file.seek(position)
            lead_in = file.read(_LEAD_IN_BYTES)
            if len(lead_in) < _LEAD_IN_BYTES or not lead_in.startswith(b"TDSm"):
                break
            (flags,) = struct.unpack_from("<L", lead_in, 4)
            (rest,) = struct.unpack_from(">Q" if flags & _BIG_ENDIAN else "<Q", lead_in, 12)
            if rest == _UNFINISHED:
                return  # a writer that crashed: the status of its channels told already
            position += _LEAD_IN_BYTES + rest
    if position != n_bytes:
        raise ConfigurationError(f"{path} is cut short, or has other bytes at its end; {_BRING_BACK}")


@contextmanager
def _translate_errors(path: Path) -> Iterator[None]:
    """Run a block; raise any of its exceptions as a ConfigurationError with file and remedy.

    A ConfigurationError is raised as it is.
    """
    try:
        yield
    except ConfigurationError:
        raise
    except PermissionError as error:
        raise ConfigurationError(f"{path} cannot be read: {error}; give this user the right to") from error
    except FileNotFoundError as error:
        raise ConfigurationError(f"there is no file {path} any more; bring it back") from error
    except Exception as error:
        # npTDMS raises what its parser meets: struct.error, KeyError, ValueError, EOFError and others.
        raise ConfigurationError(
            f"{path} is no whole TDMS file ({type(error).__name__}: {error}); {_BRING_BACK}"
        ) from error
