"""Pictures to an MP4 or GIF file."""

from collections.abc import Callable, Iterator, Mapping
from fractions import Fraction
from itertools import chain
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from cmf_mj.core.errors import InputError
from cmf_mj.core.files import whole_file

CODECS = ("libx264", "libopenh264", "mpeg4")
"""Encoders of MP4 files in order of preference: H.264, else MPEG-4 part 2."""

GIF_FPS = 50
"""Pictures a second that programs show a GIF file at, at most."""

_COMMON, _RARE = 176, 64
"""Of a GIF file: those that cover much of it, and those that are unlike the others."""


def check_format(target: Path, fps: int, speed: float, sizes: Mapping[str, int]) -> None:
    """Refuse a file name, pictures a second, speed or lengths [pixels] that no film can have."""
    if target.suffix not in (".mp4", ".gif"):
        raise InputError(f"out: {target.name} must end in .mp4 or .gif")
    if not (np.isfinite(speed) and speed > 0.0) or fps < 1:
        raise InputError(f"speed, fps: {speed}, {fps} must be greater than 0")
    if target.suffix == ".gif" and fps > GIF_FPS:
        raise InputError(f"fps: {fps} pictures a second of a GIF file must be at most {GIF_FPS}")
    for name, length in sizes.items():
        if length % 2:
            raise InputError(f"{name}: {length} pixels must be even")


def write_film(
    pictures: Iterator[NDArray[np.uint8]],
    count: int,
    target: Path,
    fps: int,
    *,
    progress: Callable[[int, int], None] | None = None,
) -> Path:
    """Write `count` pictures (height, width, 3) to a file that appears when it is complete."""

    def counted() -> Iterator[NDArray[np.uint8]]:
        for number, picture in enumerate(pictures, start=1):
            yield picture
            if progress is not None:
                progress(number, count)

    write = _write_gif if target.suffix == ".gif" else _write_mp4
    with whole_file(target) as partial:
        write(counted(), partial, fps)
    return target


def _write_mp4(pictures: Iterator[NDArray[np.uint8]], target: Path, fps: int) -> None:
    codec = mp4_codec()
    import av

    first = next(pictures)
    with av.open(str(target), "w", format="mp4") as container:
        stream = container.add_stream(codec, rate=Fraction(fps))
        stream.height, stream.width = first.shape[:2]
        stream.pix_fmt = "yuv420p"
        stream.bit_rate = 4_000_000
        for picture in chain([first], pictures):
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), format="rgb24")
            container.mux(stream.encode(frame))
        container.mux(stream.encode())


def mp4_codec() -> str:
    """The first encoder of MP4 files that opens; refused without PyAV or without encoders."""
    try:
        import av
    except ImportError as error:
        raise InputError(
            "out: an .mp4 file needs PyAV, pip install 'cmf-mj[video]'; a .gif file does not"
        ) from error
    for name in CODECS:
        try:
            av.codec.Codec(name, "w")
        except (av.codec.codec.UnknownCodecError, ValueError):
            continue
        return name
    raise InputError(f"out: PyAV has none of the encoders {', '.join(CODECS)}; write a .gif file")


def _write_gif(pictures: Iterator[NDArray[np.uint8]], target: Path, fps: int) -> None:
    """All pictures with the palette of the first, whose legend has the colours of all traces."""
    begun = Image.fromarray(next(pictures))
    methods = ((_COMMON, Image.Quantize.MEDIANCUT), (_RARE, Image.Quantize.MAXCOVERAGE))
    palette = Image.new("P", (1, 1))
    palette.putpalette(
        [
            entry
            for size, method in methods
            for entry in (begun.quantize(size, method=method).getpalette() or [])[: 3 * size]
        ]
    )
    first, *others = (
        picture.quantize(palette=palette, dither=Image.Dither.NONE)
        for picture in chain([begun], map(Image.fromarray, pictures))
    )
    # The file counts time in hundredths of a second.
    ends = 10 * np.round(100.0 / fps * np.arange(len(others) + 2)).astype(int)
    pace = {"duration": np.diff(ends).tolist(), "loop": 0, "optimize": True}
    first.save(target, format="GIF", save_all=True, append_images=others, **pace)
