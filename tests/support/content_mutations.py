"""Ways to damage what an archive holds: names, types, shapes, values, texts, attributes."""

from __future__ import annotations

from typing import Any

import h5py
import numpy as np

from tests.support.archive_nodes import Mutation, Random, chosen, datasets, groups, is_text, of, replaced

TEXTS = (
    "",
    "\x1b[31mred\x1b[0m",
    "\u202egnp.exe\u202c",
    "<script>alert(1)</script>",
    "[bold red]markup[/] [/nothing]",
    "$\\frac{$",
    "=1+1",
    "../../etc/passwd",
    "a\nb\r\nc\td",
    "x" * 100_000,
    "name: [unclosed",
    "&a [*a, *a]",
    "\u00b5 \U0001f9be",
    "finished",
)
RAW_TEXTS = (b"\xff\xfe", b"caf\xe9", b"\xed\xa0\x80", b"\xc0\x80")
NUMBERS = (np.nan, np.inf, -np.inf, 0.0, -1.0, 1e300, -1e300, 1e-320, 1e13, 9.2e18, 2**31 - 1, -(2**31))
TYPES: tuple[Any, ...] = (
    "i1",
    "u1",
    "<i2",
    ">i4",
    "<i8",
    "<u8",
    "<f2",
    "<f4",
    ">f8",
    "?",
    "c16",
    "S7",
    np.dtype([("a", "i4"), ("b", "f8")]),
    np.dtype(("f8", (2,))),
    h5py.string_dtype(),
    h5py.string_dtype(length=5),
    h5py.vlen_dtype(np.float64),
    h5py.vlen_dtype(np.uint8),
    h5py.ref_dtype,
    h5py.regionref_dtype,
    h5py.enum_dtype({"a": 0, "b": 1}, basetype="i4"),
    h5py.opaque_dtype(np.dtype("V8")),
)


def deleted_dataset(file: h5py.File, random: Random) -> str:
    path = chosen(file, random)
    del file[path]
    return path


def deleted_group(file: h5py.File, random: Random) -> str:
    path = str(random.choice(groups(file)))
    del file[path]
    return path


def renamed(file: h5py.File, random: Random) -> str:
    path = str(random.choice([*datasets(file), *groups(file)]))
    file.move(path, f"{path}_{random.choice(['x', 'mm', 'bar'])}")
    return path


def exchanged(file: h5py.File, random: Random) -> str:
    one, other = random.choice(datasets(file), 2, replace=False)
    file.move(one, "parked")
    file.move(other, one)
    file.move("parked", other)
    return f"{one} <-> {other}"


def group_for_dataset(file: h5py.File, random: Random) -> str:
    path = chosen(file, random)
    del file[path]
    file.create_group(path)["inner"] = 1.0
    return path


def dataset_for_group(file: h5py.File, random: Random) -> str:
    path = str(random.choice(groups(file)))
    del file[path]
    file[path] = [1.0, 2.0]
    return path


def type_for_dataset(file: h5py.File, random: Random) -> str:
    path = chosen(file, random)
    del file[path]
    file[path] = np.dtype("f8")
    return path


def other_type(file: h5py.File, random: Random) -> str:
    path = chosen(file, random)
    kind = TYPES[random.integers(len(TYPES))]
    shape = file[path].shape
    replaced(file, path, shape=shape, dtype=kind)
    return f"{path}: {kind}"


def other_type_written(file: h5py.File, random: Random) -> str:
    """The same numbers in another type, with every value stored."""
    path = of(file, random, lambda node: not is_text(node) and node.dtype.kind in "iuf")
    kind = str(random.choice(["f2", "f4", "f8", ">f8", "i1", "i4", "i8", ">i8", "u8"]))
    with np.errstate(all="ignore"):
        replaced(file, path, data=np.asarray(file[path][()]).astype(kind))
    return f"{path}: {kind}"


def other_shape(file: h5py.File, random: Random) -> str:
    path = of(file, random, lambda node: not is_text(node) and node.dtype.kind in "iuf")
    data = np.asarray(file[path][()])
    shapes: list[Any] = [data[None], data.ravel()[:0], np.asarray(data.flat[0] if data.size else 0, data.dtype)]
    if data.ndim:
        shapes += [data[:-1], np.concatenate((data, data[-1:])), data.T, data[..., None], data[::2], data[:1]]
    if data.ndim > 1:
        shapes += [data[:, :-1], data.reshape(-1)]
    found = shapes[random.integers(len(shapes))]
    replaced(file, path, data=found)
    return f"{path}: {data.shape} -> {np.shape(found)}"


def other_length_of_texts(file: h5py.File, random: Random) -> str:
    path = of(file, random, lambda node: is_text(node) and node.ndim == 1)
    words = list(file[path].asstr()[()])
    found = [words[:-1], [*words, "more"], [], words * 3][random.integers(4)]
    replaced(file, path, data=np.array(found, dtype=object), dtype=h5py.string_dtype())
    return f"{path}: {len(words)} -> {len(found)}"


def numbers(file: h5py.File, random: Random) -> str:
    path = of(file, random, lambda node: not is_text(node) and node.dtype.kind in "iuf" and node.size)
    value = NUMBERS[random.integers(len(NUMBERS))]
    data = np.asarray(file[path][()])
    with np.errstate(all="ignore"):
        number = np.asarray(value).astype(data.dtype)
    if data.ndim and random.random() < 0.6:
        data[tuple(random.integers(data.shape))] = number
    else:
        data = np.full_like(data, number)
    file[path][...] = data
    return f"{path}: {value}"


def shuffled(file: h5py.File, random: Random) -> str:
    path = of(file, random, lambda node: not is_text(node) and node.dtype.kind in "iuf" and node.ndim and node.size)
    data = np.asarray(file[path][()])
    random.shuffle(data)
    file[path][...] = data
    return path


def texts(file: h5py.File, random: Random) -> str:
    path = of(file, random, lambda node: is_text(node) and node.size)
    word = TEXTS[random.integers(len(TEXTS))]
    if file[path].ndim and random.random() < 0.6:
        file[path][int(random.integers(len(file[path])))] = word
    else:
        file[path][...] = word
    return f"{path}: {word[:20]!r}"


def texts_that_are_none(file: h5py.File, random: Random) -> str:
    path = of(file, random, lambda node: is_text(node) and node.size)
    word = RAW_TEXTS[random.integers(len(RAW_TEXTS))]
    shape = file[path].shape
    node = replaced(file, path, shape=shape, dtype=h5py.string_dtype())
    node[...] = word
    return f"{path}: {word!r}"


def attribute(file: h5py.File, random: Random) -> str:
    """An attribute of another type, of the file, a group or a dataset."""
    node = file[str(random.choice(["/", *groups(file), *datasets(file)]))]
    usual = ["units", "source", "uncertainty", "NX_class", "default", "signal", "axes", "CLASS", "NAME"]
    names = sorted({*node.attrs, *(["DIMENSION_LIST", "REFERENCE_LIST"] if "DIMENSION_LIST" in node.attrs else usual)})
    name = str(random.choice(names))
    values: list[Any] = [
        "a text",
        "",
        b"\xff\xfe",
        7,
        2**63,
        np.nan,
        np.inf,
        [1.0, 2.0],
        np.array(["a", "b"], dtype=h5py.string_dtype()),
        np.void(b"opaque"),
        h5py.Empty("f8"),
        file["entry"].ref,
        "x" * 60_000,
        np.zeros(3, [("a", "i4"), ("b", "f8")]),
    ]
    k = int(random.integers(len(values) + 1))
    if name in node.attrs:
        del node.attrs[name]
    if k < len(values):
        node.attrs[name] = values[k]
    return f"{node.name}@{name}: {'deleted' if k == len(values) else str(values[k])[:20]}"


def text_for_dimension_list(file: h5py.File, random: Random) -> str:
    path = of(file, random, lambda node: "DIMENSION_LIST" in node.attrs)
    del file[path].attrs["DIMENSION_LIST"]
    file[path].attrs["DIMENSION_LIST"] = "time"
    return path


def names_of_the_run(file: h5py.File, random: Random) -> str:
    """Damage names in the groups whose field names come from the run."""
    group = str(random.choice(["calibration", "model", "versions", "timing/counters"]))
    names = ["\x1b[31m", "\u202eabc", "<b>", "a" * 5000, "$x$", "=1", "component_9", "[red]"]
    name = names[random.integers(len(names))]
    raw = random.random() < 0.2
    kinds: list[Any] = [1.5, 7, "text", [1.0, 2.0], [[1.0]], np.nan, np.inf, h5py.Empty("f8"), True]
    value = kinds[random.integers(len(kinds))]
    parent = file[f"entry/{group}"]
    if raw:
        space = h5py.h5s.create(h5py.h5s.SCALAR)
        h5py.h5d.create(parent.id, b"caf\xe9", h5py.h5t.IEEE_F64LE, space)
        return f"{group}: a name that is no UTF-8"
    parent[name] = value
    return f"{group}/{name[:20]}: {value}"


def many_names(file: h5py.File, random: Random) -> str:
    group = str(random.choice(["calibration", "versions"]))
    for number in range(int(random.choice([3000, 300]))):
        file[f"entry/{group}/many{number}"] = "1" if group == "versions" else 1.0
    return group


def more(file: h5py.File, random: Random) -> str:
    """Datasets that no archive has; readers ignore them."""
    group = str(random.choice([*groups(file), "/"]))
    values: list[Any] = ["text", [1.0], np.zeros(2, [("a", "i4")]), h5py.Empty("f8"), h5py.SoftLink("/nowhere")]
    file[f"{group}/more"] = values[random.integers(len(values))]
    return group


def picture(file: h5py.File, random: Random) -> str:
    images = file["entry/frames/image"]
    if len(images) == 0:
        return "no pictures"
    k = int(random.integers(len(images)))
    data = bytearray(images[k].tobytes())
    found = [b"", b"no picture", bytes(data[: len(data) // 2]), bytes(random.bytes(300)), bytes(data[::-1])]
    images[k] = np.frombuffer(found[random.integers(len(found))], np.uint8)
    return f"picture {k}"


def version(file: h5py.File, random: Random) -> str:
    values: list[Any] = [0, -1, 2, 2**62, "1", 1.5, np.nan, [1, 1], h5py.Empty("i8"), b"\xff"]
    name = str(random.choice(["layout_version", "content_sha256"]))
    k = int(random.integers(len(values)))
    del file.attrs[name]
    file.attrs[name] = values[k]
    return f"@{name}: {values[k]}"


def channels(file: h5py.File, random: Random) -> str:
    name = str(random.choice(["actuators", "valves"]))
    value = int(random.choice([-1, 0, 1, 4, 4096, 5000, 2**31 - 1]))
    file[f"entry/{name}"][()] = value
    return f"{name}: {value}"


CONTENT: tuple[Mutation, ...] = (
    deleted_dataset,
    deleted_group,
    renamed,
    exchanged,
    group_for_dataset,
    dataset_for_group,
    type_for_dataset,
    other_type,
    other_type_written,
    other_shape,
    other_length_of_texts,
    numbers,
    shuffled,
    texts,
    texts_that_are_none,
    attribute,
    text_for_dimension_list,
    names_of_the_run,
    many_names,
    more,
    picture,
    version,
    channels,
)
