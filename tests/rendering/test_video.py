"""Films are read back and checked for what a browser needs."""

from pathlib import Path

import av
import numpy as np
import pytest

from craftsim.rendering.encode import VideoWriter


def _frames(count: int, height: int = 48, width: int = 64) -> list[np.ndarray]:
    ramp = np.linspace(0, 255, width, dtype=np.uint8)
    frames = np.zeros((count, height, width, 3), np.uint8)
    for number, frame in enumerate(frames):
        frame[..., 0] = np.roll(ramp, 3 * number)
        frame[..., 2] = 255 - ramp
    return list(frames)


def _write(path: Path, frames: list[np.ndarray], fps: int = 25) -> None:
    with VideoWriter(path, fps) as writer:
        for frame in frames:
            writer.write(frame)


def test_a_film_is_h264_yuv420p_with_all_frames_at_the_asked_rate(tmp_path):
    frames = _frames(10)
    _write(tmp_path / "film.mp4", frames)
    with av.open(str(tmp_path / "film.mp4")) as container:
        stream = container.streams.video[0]
        assert stream.codec_context.name == "h264"
        assert stream.pix_fmt == "yuv420p"
        assert (stream.width, stream.height) == (64, 48)
        assert stream.average_rate == 25
        assert float(stream.duration * stream.time_base) == pytest.approx(10 / 25)
        decoded = [picture.to_ndarray(format="rgb24") for picture in container.decode(stream)]
    assert len(decoded) == 10
    for written, read in zip(frames, decoded, strict=True):
        assert np.abs(written.astype(int) - read).mean() < 12  # lossy, and colour at half resolution


def test_the_index_comes_before_the_pictures(tmp_path):
    _write(tmp_path / "film.mp4", _frames(5))
    content = (tmp_path / "film.mp4").read_bytes()
    assert content.index(b"moov") < content.index(b"mdat")


def test_the_same_frames_give_the_same_bytes(tmp_path):
    for name in ("a.mp4", "b.mp4"):
        _write(tmp_path / name, _frames(6))
    assert (tmp_path / "a.mp4").read_bytes() == (tmp_path / "b.mp4").read_bytes()


def test_a_repeated_frame_stays_on_screen(tmp_path):
    with VideoWriter(tmp_path / "film.mp4", 25) as writer:
        writer.write(_frames(1)[0], repeat=7)
    with av.open(str(tmp_path / "film.mp4")) as container:
        assert sum(1 for _ in container.decode(video=0)) == writer.frames == 7


def _raise_midway(path: Path) -> None:
    with VideoWriter(path, 25) as writer:
        writer.write(_frames(1)[0])
        raise RuntimeError("the simulation went wrong")


def test_an_error_keeps_the_previous_film(tmp_path):
    _write(tmp_path / "film.mp4", _frames(3))
    before = (tmp_path / "film.mp4").read_bytes()
    with pytest.raises(RuntimeError, match="went wrong"):
        _raise_midway(tmp_path / "film.mp4")
    assert (tmp_path / "film.mp4").read_bytes() == before


def test_a_film_without_frames_is_an_error(tmp_path):
    with pytest.raises(ValueError, match="at least one frame"), VideoWriter(tmp_path / "film.mp4", 25):
        pass
    assert list(tmp_path.iterdir()) == []


def test_frames_that_cannot_be_encoded_are_refused(tmp_path):
    for frame, message in (
        (np.zeros((48, 63, 3), np.uint8), "even sizes"),
        (np.zeros((48, 64), np.uint8), "height, width, 3"),
        (np.zeros((48, 64, 3)), "uint8"),
    ):
        with pytest.raises(ValueError, match=message), VideoWriter(tmp_path / "film.mp4", 25) as writer:
            writer.write(frame)


def test_a_frame_of_another_size_is_refused(tmp_path):
    with pytest.raises(ValueError, match="this film is 64 x 48"):
        _write(tmp_path / "film.mp4", [_frames(1)[0], _frames(1, 32, 32)[0]])
