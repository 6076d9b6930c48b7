"""Bags that claim less than they hold, or ask for more work than they are long."""

import resource
import tracemalloc
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("mcap_ros2")

import lz4.frame
import zstandard
from mcap.records import Channel, Message
from mcap_ros2.decoder import DecoderFactory
from robots.bags import loose_bag, records_of, write_bag

from craftsim.errors import InputError
from craftsim.robots import bags
from craftsim.robots.log import GROUPS, Log
from craftsim.robots.log_files import read_log
from craftsim.storage.limits import BAG_MESSAGE_BYTES, MIB

BOMB_MIB = 512


@pytest.fixture(scope="module")
def log():
    rng = np.random.default_rng(0)
    groups = {name: 0.01 * rng.normal(size=(20, len(columns))) for name, columns in GROUPS.items()}
    return Log(0.02 * np.arange(20), **groups)


@pytest.fixture
def bag(log, tmp_path):
    return write_bag(tmp_path / "run.mcap", log).read_bytes()


@contextmanager
def little_memory(allowed):
    """Allow this process so many bytes more."""
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    before = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (used + allowed, before[1]))
    tracemalloc.start()
    try:
        yield
        assert tracemalloc.get_traced_memory()[1] < allowed
    finally:
        tracemalloc.stop()
        resource.setrlimit(resource.RLIMIT_AS, before)


def packed_zeros(packing):
    packer = (
        zstandard.ZstdCompressor().compressobj()
        if packing == "zstd"
        else lz4.frame.LZ4FrameCompressor()
    )
    parts = [packer.begin()] if packing == "lz4" else []
    parts += [packer.compress(bytes(MIB)) for _ in range(BOMB_MIB)]
    return b"".join([*parts, packer.flush()])


@pytest.mark.parametrize("packing", ["zstd", "lz4", "zstd with its size"])
def test_a_chunk_is_unpacked_no_further_than_it_claims(packing, bag, tmp_path):
    if packing == "zstd with its size":
        content = zstandard.ZstdCompressor().compress(bytes(BOMB_MIB * MIB))
    else:
        content = packed_zeros(packing)
    path = tmp_path / "bomb.mcap"
    path.write_bytes(loose_bag(bag, chunk=(packing.split()[0], content)))
    with pytest.raises(
        InputError, match=r"bomb\.mcap: damaged: a chunk does not hold what it claims"
    ):
        read_log(path)  # and imports
    with little_memory(BOMB_MIB * MIB // 4), pytest.raises(InputError, match="hold what it claims"):
        read_log(path)


def test_a_chunk_that_claims_too_much_or_an_unknown_packing_is_refused(bag, tmp_path):
    path = tmp_path / "bomb.mcap"
    hostile = loose_bag(bag, chunk=("zstd", b"")).replace(
        (1000).to_bytes(8, "little"), (2**40).to_bytes(8, "little")
    )
    for data, message in {
        hostile: "unpacks to 1024 GiB; allowed: 64 MiB a chunk, 1 GiB in all",
        loose_bag(bag, chunk=("lzma", b"")): "packed by 'lzma'; allowed: zstd, lz4",
    }.items():
        path.write_bytes(data)
        with pytest.raises(InputError, match=message):
            read_log(path)


def test_a_schema_is_not_parsed_however_long_it_is(log, bag, tmp_path):
    fields = "".join(f"\nbool f{i}" for i in range(40_000)).encode()
    (tmp_path / "long.mcap").write_bytes(loose_bag(bag, schema=fields))
    read = read_log(tmp_path / "long.mcap")
    assert np.allclose(read.pose[:, :2], log.pose[:, :2])


def test_messages_without_chunks_and_in_any_order_are_the_same_log(log, bag, tmp_path):
    messages = records_of(bag, Message)
    (tmp_path / "loose.mcap").write_bytes(loose_bag(bag, messages[::-1]))
    read, packed = read_log(tmp_path / "loose.mcap"), read_log(tmp_path / "run.mcap")
    assert len(read) == len(log)
    for name, values in packed.columns.items():
        assert np.array_equal(read.columns[name], values, equal_nan=True), name


def test_a_large_message_is_passed_over_unless_it_would_be_decoded(bag, tmp_path):
    path, messages = tmp_path / "large.mcap", records_of(bag, Message)
    messages[0].data += bytes(BAG_MESSAGE_BYTES)
    path.write_bytes(loose_bag(bag, messages))
    with pytest.raises(InputError, match=r"a message of 64\.\d+ KiB on a topic that is read"):
        read_log(path)
    messages[0].channel_id = 999
    path.write_bytes(loose_bag(bag, messages))
    assert len(read_log(path)) == 20


def test_records_and_messages_are_counted_as_they_come(bag, tmp_path, monkeypatch):
    path = tmp_path / "many.mcap"
    path.write_bytes(loose_bag(bag))
    monkeypatch.setattr(bags, "BAG_MESSAGES", 20)  # of each of three topics
    assert len(read_log(path)) == 20
    monkeypatch.setattr(bags, "BAG_MESSAGES", 19)
    with pytest.raises(InputError, match="/localisation has more than the 19 messages"):
        read_log(path)
    monkeypatch.setattr(bags, "BAG_RECORDS", 20)
    with pytest.raises(InputError, match="more than the 20 records"):
        read_log(path)


@pytest.mark.parametrize("topic", ["/localisation", "/pose_{:04d}"])
def test_many_channels_share_a_decoder_and_many_topics_are_not_all_listed(
    topic, bag, tmp_path, monkeypatch
):
    path, made = tmp_path / "channels.mcap", []
    build = DecoderFactory.decoder_for
    monkeypatch.setattr(
        DecoderFactory, "decoder_for", lambda *args: made.append(args) or build(*args)
    )
    bags._decoder.cache_clear()
    schema = records_of(bag, Channel)[0].schema_id
    more = [Channel(100 + n, topic.format(n), "cdr", {}, schema) for n in range(1000)]
    path.write_bytes(loose_bag(bag, channels=more))
    if topic == "/localisation":
        assert len(read_log(path)) == 20
        assert len(made) == 2  # poses, and joints for commands and measurements
    else:
        with pytest.raises(
            InputError, match=r"/localisation, /pose_0000, .*, \.\.\.; name one"
        ) as error:
            read_log(path)
        assert len(str(error.value)) < 400


def test_a_bag_that_is_cut_off_says_so(bag, tmp_path):
    for cut in (1, 40, 2000):
        (tmp_path / "cut.mcap").write_bytes(bag[:-cut])
        with pytest.raises(InputError, match=r"cut\.mcap: .*'mcap recover' repairs it"):
            read_log(tmp_path / "cut.mcap")
