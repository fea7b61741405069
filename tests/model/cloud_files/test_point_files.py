"""Point clouds in files: exact round trips, foreign files, and what is refused."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import h5py
import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.io import loadmat, savemat
from scipy.sparse import csc_array

from isacbench.errors import InputError
from isacbench.model.cloud import PointCloud
from isacbench.model.cloud_files.point_files import read_points_csv
from tests.conftest import few

from ...cubes.samples import put_mat73, write_mat73

FORMATS = ("csv", "npy", "npz", "mat", "ply")
TABLE = np.array([[1.0, 2, 3, 4, 0.5], [-0.1, 1 / 3, 1e-7, -3, 2.25]])
finite = st.floats(allow_nan=False, allow_infinity=False)


def refusal(path: Path) -> str:
    """Message with which a file is refused, less its path."""
    with pytest.raises(InputError) as refused:
        PointCloud.read(path)
    message = str(refused.value)
    assert message.startswith(f"{path}: ")
    return message.removeprefix(f"{path}: ")


def text_file(folder: Path, name: str, text: str) -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


# Round trips


@pytest.mark.parametrize("suffix", FORMATS)
@few
@given(table=st.integers(0, 6).flatmap(lambda n: arrays(np.float64, (n, 5), elements=finite)))
def test_a_round_trip_returns_the_same_doubles(suffix: str, table: np.ndarray) -> None:
    cloud = PointCloud.from_array(table)
    with TemporaryDirectory() as folder:
        path = Path(folder) / f"cloud.{suffix}"
        cloud.write(path)
        found = PointCloud.read(path).to_array()
    assert np.array_equal(found, table)
    assert np.array_equal(np.signbit(found), np.signbit(table))


@pytest.mark.parametrize("suffix", FORMATS)
def test_writing_overwrites_and_takes_upper_case_and_strings(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"CLOUD.{suffix.upper()}"
    PointCloud.from_array(np.ones((50, 5))).write(path)
    PointCloud.from_array(TABLE).write(str(path))
    assert np.array_equal(PointCloud.read(str(path)).to_array(), TABLE)
    assert [found.name for found in tmp_path.iterdir()] == [path.name]


def test_written_csv_has_the_header_and_short_numbers(tmp_path: Path) -> None:
    path = tmp_path / "cloud.csv"
    PointCloud.from_array(TABLE[:1]).write(path)
    assert path.read_bytes() == b"x,y,z,v,power\n1.0,2.0,3.0,4.0,0.5\n"


def test_written_mat_and_npz_name_their_arrays(tmp_path: Path) -> None:
    for suffix, load in (("mat", loadmat), ("npz", np.load)):
        PointCloud.from_array(TABLE).write(tmp_path / f"cloud.{suffix}")
        found = load(tmp_path / f"cloud.{suffix}")
        assert np.array_equal(found["xyz"], TABLE[:, :3])
        assert np.array_equal(found["velocity"].ravel(), TABLE[:, 3])
        assert np.array_equal(found["power"].ravel(), TABLE[:, 4])


# Any format


@pytest.mark.parametrize("name", ["cloud.txt", "cloud.pcd", "cloud"])
def test_another_extension_is_refused_with_the_allowed_ones(tmp_path: Path, name: str) -> None:
    path = text_file(tmp_path, name, "")
    found = f"extension {path.suffix!r}" if path.suffix else "no extension"
    assert refusal(path) == f"has {found}; a cloud takes .csv, .npy, .npz, .mat, .ply"
    with pytest.raises(InputError, match=r"a cloud takes \.csv, \.npy, \.npz, \.mat, \.ply"):
        PointCloud.empty().write(path)


@pytest.mark.parametrize("suffix", FORMATS)
def test_a_missing_file_and_a_directory_are_refused(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"cloud.{suffix}"
    assert refusal(path) == "does not exist"
    path.mkdir()
    assert refusal(path) == "is a folder, not a file"
    with pytest.raises(InputError, match="cannot be written: Is a directory"):
        PointCloud.empty().write(path)


@pytest.mark.parametrize("suffix", FORMATS)
def test_a_folder_that_does_not_exist_cannot_be_written_to(tmp_path: Path, suffix: str) -> None:
    with pytest.raises(InputError, match="cannot be written: No such file or directory"):
        PointCloud.empty().write(tmp_path / "nowhere" / f"cloud.{suffix}")


# csv


@pytest.mark.parametrize(
    "text",
    [
        "x,y,z,v,power\n1,2,3,4,1\n5,6,7,8,1\n",
        "x,y,z,v\n1,2,3,4\n5,6,7,8",
        "v, z, y, x\r\n4, 3, 2, 1\r\n8, 7, 6, 5\r\n",
        "1,2,3,4\n5,6,7,8\n",
        "1e0,2.0,+3,4,1\n\n5,6,7,8,1\n\n",
        "\ufeffx,y,z,v\n1,2,3,4\n5,6,7,8\n",
    ],
)
def test_csv_is_read_with_and_without_header_and_power(tmp_path: Path, text: str) -> None:
    found = PointCloud.read(text_file(tmp_path, "cloud.csv", text)).to_array()
    assert found.tolist() == [[1, 2, 3, 4, 1], [5, 6, 7, 8, 1]]


def test_a_csv_of_a_header_alone_is_an_empty_cloud(tmp_path: Path) -> None:
    assert len(PointCloud.read(text_file(tmp_path, "cloud.csv", "x,y,z,v,power\n"))) == 0


TAKES = "a cloud takes x, y, z and, if there, v (or velocity) and power; it has"
NO_VELOCITY = "allowed is the name velocity for m/s, positive when approaching, or nothing like it"
NO_NUMBERS = "rows without their numbers (pandas: index=False, R: row.names=FALSE)"
NAME_EACH = f"allowed are a name for each, or {NO_NUMBERS}"
NO_POWER = "allowed is the name power for powers relative to a unit scatterer, or nothing like it"
THOUSANDS = "decimal or set thousands apart; allowed are decimal points"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is empty; at least the header x,y,z is required"),
        (" \n\n", "is empty; at least the header x,y,z is required"),
        (
            "x,y,z,v,amplitude\n1,2,3,4,5\n",
            f"has no power, but amplitude; {NO_POWER} for points of power 1",
        ),
        ("\nx,y,z,speed\n1,2,3,4\n", f"has no velocity, but speed; {NO_VELOCITY} for unknown velocities"),
        ("x,y,z,v [m/s]\n", f"has no velocity, but v [m/s]; {NO_VELOCITY} for unknown velocities"),
        ("x,y,v,power\n", f"row 1: z is missing; {TAKES} x, y, v, power"),
        ("x,y,z,v,v\n", f"row 1: v appears twice, as v and v; {TAKES} x, y, z, v, v"),
        ("X,x,y,z,v\n", f"row 1: x appears twice, as X and x; {TAKES} X, x, y, z, v"),
        ("x,y,z,v,velocity\n", f"row 1: v appears twice, as v and velocity; {TAKES} x, y, z, v, velocity"),
        ("x,y,z,u,v\n", f"row 1: v beside u is of a texture; {TAKES} x, y, z, u, v"),
        ("V1,V2,V3,V4\n1,2,3,4\n", f"row 1: x is missing; {TAKES} V1, V2, V3, V4"),
        ("x,y,z,v\n1,2,3,4\n1,2,3,nan\n", "row 3: column v is NaN; expected a finite number"),
        ("x,y,z,v\n\n1,-inf,3,4\n", "row 3: column y is infinite; expected a finite number"),
        ("x,y,z,v\n1,2,3\n", "row 2: column v is ''; expected a number"),
        ("x y z v\n1 2 3\n", "row 2: 3 fields instead of 4 (x, y, z, v)"),
        ("x,y,z,v\n1,2,3,4,5,6\n", "row 2: 6 fields instead of 4 (x, y, z, v)"),
        *(
            (text, f"row 2: {n + 1} fields instead of {n} ({names}); {NAME_EACH}")
            for text, n, names in (
                ("x,y,z,v\n2,2,3,4,5\n", 4, "x, y, z, v"),
                ("x,y,z\n1,2,3,5\n", 3, "x, y, z"),
                ("x;y;z\n1,5;2;3;5\n", 3, "x, y, z"),
                ('"x","y","z"\n"1.5","2.5","3.5","4.5"\n', 3, "x, y, z"),
                ("x y z\n3 1 2 3\n9 4 5 6\n", 3, "x, y, z"),
            )
        ),
        ("x,y,z,v\n1,2,3,4,\n", "row 2: 5 fields instead of 4 (x, y, z, v)"),
        *(
            (text, f"row {row}: may be a comment or a row; a row takes no # or // in front")
            for row, text in (
                (3, "x,y,z\n1,2,3\n#N/A,5,6\n"),
                (4, "x;y;z\r\n1;2;3\r\n# half\r\n #NV;5;6\r\n"),
                (2, ",x,y,z\n#1,1,2,3\nb,4,5,6\n"),
                (2, "x y z\n#1 1 2 3\n"),
                (3, "1,2,3\n4,5,6\n//7,8,9\n"),
            )
        ),
        ("x,y,z,v\n\n1,2,3,4\n1,2,3,4,5\n", "row 4: 5 fields instead of 4 (x, y, z, v)"),
        ("x,y,z,v\n1,2,3,True\n", "row 2: column v is 'True'; expected a number"),
        ("x,y,z,v\n1,2,3,NA\n", "row 2: column v is 'NA'; expected a number"),
        ("x;y;z;v\n1,5;2;3.5;4\n", "row 2: column z is '3.5'; expected a number"),
        ("x\ty\tz\n1,5\t2\t3.5\n", "row 2: column z is '3.5'; expected a number"),
        ("x y z\n1 ,2 ,3\n", "row 2: column y is ',2'; expected a number"),
        ("1,5 2,5 3,5\n", "row 1: column y is '5 2'; expected a number"),
        ("x\ty\tz\n1,234\t2\t5,678\n", f"commas may be {THOUSANDS}"),
        ("x;y;z;v\n1.234,5;2;3;4\n", "row 2: column x is '1.234,5'; expected a number"),
        (
            'x,y,z,v,a\n1,2,3,4,b\n1,2,3,4,"a\nb"\n',
            "has a line break within quotes; allowed is one line a row",
        ),
        ("x,y,z,v\n1,2,3,\n", "row 2: column v is ''; expected a number"),
        ("x,y,z,v\n1,2, abc,4\n", "row 2: column z is 'abc'; expected a number"),
        ("1,2,3,four\n", "row 1: column v is 'four'; expected a number"),
        ("x,y,z,v\n1,2,1_0,4\n", "row 2: column z is '1_0'; expected a number"),
        ("x,y,z,v\n1,2,3,４\n", "row 2: column v is '４'; expected a number"),
        ("1_0,2,3,4\n", "row 1: column x is '1_0'; expected a number"),
        ("1,2,0x1p3,4\n", "row 1: column z is '0x1p3'; expected a number"),
        ("1,2,3,4\n1,2,3,4,5\n", "row 2: 5 fields instead of 4 (x, y, z, v)"),
        *(
            (text, f"row 1: {n} fields; without a header a cloud takes 3, 4 or 5 (x, y, z, v, power){remedy}")
            for text, n, remedy in (
                ("1,2\n", 2, ""),
                ("0,1,2,3,4,5.5\n", 6, f", in {NO_NUMBERS}"),
                ("3\n1 2 3\n4 5 6\n", 1, ""),
                ("1\nx y z\n", 1, ""),
            )
        ),
    ],
)
def test_a_faulty_csv_is_refused_with_its_place(tmp_path: Path, text: str, message: str) -> None:
    assert refusal(text_file(tmp_path, "cloud.csv", text)) == message


# Scatterers of a scenario


def test_points_are_read_with_and_without_amplitude(tmp_path: Path) -> None:
    points = read_points_csv(text_file(tmp_path, "a.csv", "amplitude,x,y,z,v\n0.5,1,2,3,4\n"))
    assert (points.xyz.tolist(), points.velocity.tolist(), points.amplitude.tolist()) == (
        [[1, 2, 3]],
        [4],
        [0.5],
    )
    assert read_points_csv(
        text_file(tmp_path, "b.csv", "x,y,z,v\n1,2,3,4\n1,2,3,4\n")
    ).amplitude.tolist() == [1, 1]


TAKES_AMPLITUDE = "the file takes the columns x, y, z, v and optionally amplitude and object"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x,y,z,v\n", "holds no points below its header"),
        ("x,y,z\n1,2,3\n", f"row 1: column v is missing; {TAKES_AMPLITUDE}"),
        ("x,y,z,v,power\n1,2,3,4,5\n", f"row 1: unknown column 'power'; {TAKES_AMPLITUDE}"),
        ("x,y,z,v,velocity\n1,2,3,4,5\n", f"row 1: column v appears twice; {TAKES_AMPLITUDE}"),
        ("1,2,3,4\n", f"row 1: column x is missing; {TAKES_AMPLITUDE}"),
    ],
)
def test_a_faulty_points_file_is_refused_with_its_place(tmp_path: Path, text: str, message: str) -> None:
    path = text_file(tmp_path, "points.csv", text)
    with pytest.raises(InputError) as refused:
        read_points_csv(path)
    assert str(refused.value) == f"{path}: {message}"


# npy, npz and mat


@pytest.mark.parametrize(
    ("array", "message"),
    [
        (
            np.zeros((2, 6)),
            "takes real numbers of shape (n, 3), (n, 4) or (n, 5), not float64 of shape (2, 6)",
        ),
        (np.zeros(4), "takes real numbers of shape (n, 3), (n, 4) or (n, 5), not float64 of shape (4,)"),
        (
            np.array([["a"] * 4]),
            "takes real numbers of shape (n, 3), (n, 4) or (n, 5), not <U1 of shape (1, 4)",
        ),
        (np.array([[0, 0, 0, 0], [0, 0, np.nan, 0]]), "row 2: column z is NaN; expected a finite number"),
        (np.array([[0, 0, 0, 0, -np.inf]]), "row 1: column power is infinite; expected a finite number"),
    ],
)
def test_a_faulty_npy_is_refused(tmp_path: Path, array: np.ndarray, message: str) -> None:
    np.save(tmp_path / "cloud.npy", array)
    assert refusal(tmp_path / "cloud.npy") == message


SAVES = {
    "npz": np.savez,
    "mat": lambda path, **named: savemat(path, named),
    "mat 7.3": write_mat73,
}
"""Writers of named arrays, as NumPy, as MATLAB's options -v6 and -v7.3."""


@pytest.fixture(params=SAVES)
def save(request: pytest.FixtureRequest, tmp_path: Path) -> Callable[..., Path]:
    def write(**named: Any) -> Path:
        path = tmp_path / f"cloud.{request.param[:3]}"
        SAVES[request.param](path, **named)
        return path

    return write


@pytest.mark.parametrize(
    "named",
    [
        {"whatever": TABLE},
        {"settings": np.zeros((2, 3)), "label": "street", "estimate": TABLE},
        {"xyz": TABLE[:, :3], "velocity": TABLE[:, 3], "power": TABLE[:, 4]},
        {"xyz": TABLE[:, :3], "velocity": TABLE[:, 3:4], "power": TABLE[:, 4:].T, "other": TABLE},
    ],
)
def test_npz_and_mat_are_read_as_parts_or_as_the_only_table(
    save: Callable[..., Path], named: dict[str, Any]
) -> None:
    assert np.array_equal(PointCloud.read(save(**named)).to_array(), TABLE)


@pytest.mark.parametrize(
    "others",
    [
        {"points": np.ones((50, 3)), "doppler": np.ones(50)},
        {name: np.ones(50) for name in ("x", "y", "z", "v")},
        {"points": np.ones((5, 3))},
    ],
)
def test_the_pose_of_a_sensor_is_not_taken_for_the_cloud_beside_it(
    save: Callable[..., Path], others: dict[str, Any]
) -> None:
    with pytest.raises(InputError, match="pose may be the cloud, and so may "):
        PointCloud.read(save(pose=np.eye(4), **others))


def test_a_table_is_not_taken_for_the_cloud_of_a_structure_beside_it(tmp_path: Path) -> None:
    path = tmp_path / "cloud.mat"
    savemat(path, {"truth": {"points": np.ones((50, 4))}, "estimate": np.ones((3, 4))})
    with pytest.raises(InputError, match="estimate may be the cloud, and so may truth/points"):
        PointCloud.read(path)


def test_npz_and_mat_without_power_have_power_one(save: Callable[..., Path]) -> None:
    for named in ({"p": TABLE[:, :4]}, {"xyz": TABLE[:, :3], "velocity": TABLE[:, 3]}):
        found = PointCloud.read(save(**named)).to_array()
        assert np.array_equal(found, np.column_stack([TABLE[:, :4], [1, 1]]))


@pytest.mark.parametrize("dtype", ["f4", "u2", "i8"])
def test_npz_and_mat_of_other_classes_than_double_are_read(save: Callable[..., Path], dtype: str) -> None:
    table = np.arange(12, dtype=dtype).reshape(3, 4)
    assert np.array_equal(PointCloud.read(save(table=table)).to_array()[:, :4], table)


@pytest.mark.parametrize("columns", [4, 5])
def test_npz_and_mat_of_no_points_are_an_empty_cloud(save: Callable[..., Path], columns: int) -> None:
    assert len(PointCloud.read(save(table=np.empty((0, columns))))) == 0


POWERS = "Power", "rcs", "RCS_dBsm", "echo_power", "amplitude", "Intensity", "snr_db", "sigma", "pwr", "RCSdB"


@pytest.mark.parametrize("name", POWERS)
def test_a_power_under_another_name_is_refused_and_never_1(save: Callable[..., Path], name: str) -> None:
    parts = {"xyz": TABLE[:, :3], "velocity": TABLE[:, 3]}
    for cloud in (parts, {"cloud": TABLE[:, :4]}):
        assert refusal(save(**cloud, **{name: TABLE[:, 4]})).startswith(
            f"has no power, but {name}; {NO_POWER}"
        )
        found = PointCloud.read(save(**parts, power=TABLE[:, 4], **{name: TABLE[:, 4] + 1}))
        assert np.array_equal(found.power, TABLE[:, 4])


def test_scalars_texts_and_other_arrays_beside_a_cloud_without_power_are_no_power(
    save: Callable[..., Path],
) -> None:
    path = save(
        xyz=TABLE[:, :3], velocity=TABLE[:, 3], power_dbm=20.0, power_unit="1", label=np.array([3, 4])
    )
    assert PointCloud.read(path).power.tolist() == [1, 1]


@pytest.mark.parametrize("power", [csc_array(TABLE[:, 4:]), {"linear": TABLE[:, 4]}])
def test_a_power_of_another_kind_is_refused(tmp_path: Path, power: Any) -> None:
    named = {"xyz": TABLE[:, :3], "velocity": TABLE[:, 3], "power": power}
    savemat(tmp_path / "cloud.mat", named)
    assert re.match(
        "power takes 2 real numbers|has no power, but power/linear", refusal(tmp_path / "cloud.mat")
    )


@pytest.mark.parametrize("name", ["Velocity", "doppler", "vel"])
def test_a_velocity_under_another_name_is_refused(save: Callable[..., Path], name: str) -> None:
    message = f"has no velocity, but {name}; {NO_VELOCITY}"
    assert refusal(save(xyz=TABLE[:, :3], **{name: TABLE[:, 3]})).startswith(message)
    assert refusal(save(points=TABLE[:, :3], **{name: TABLE[:, 3]})).startswith(message)


ARRAYS = (
    "takes xyz (n, 3), optionally velocity (n) and power (n), "
    "or exactly one array of shape (n, 4) or (n, 5), or else (n, 3)"
)


@pytest.mark.parametrize(
    ("named", "message"),
    [
        ({"estimate": TABLE, "truth": TABLE}, f"{ARRAYS}; several could be the cloud: estimate, truth"),
        ({"points": np.zeros((2, 6))}, f"{ARRAYS}; it holds points (float64 of shape (2, 6))"),
        ({"rotation": np.eye(3)}, f"{ARRAYS}; it holds rotation (float64 of shape (3, 3))"),
        (
            {"normals": TABLE[:, :3], "points": TABLE[:, :3]},
            f"{ARRAYS}; several could be the cloud: normals, points",
        ),
        ({}, f"{ARRAYS}; it holds nothing"),
        (
            {"velocity": TABLE[:, 3]},
            "has no array xyz, but takes xyz (n, 3), optionally velocity (n) and power (n)",
        ),
        (
            {"xyz": TABLE, "velocity": TABLE[:, 3]},
            "xyz takes real numbers of shape (n, 3), not float64 of shape (2, 5)",
        ),
        (
            {"xyz": TABLE[:, :3], "velocity": np.zeros((1, 3))},
            "velocity takes 2 real numbers, one a row of xyz, not float64 of shape (1, 3)",
        ),
        (
            {"xyz": TABLE[:, :3], "velocity": TABLE[:, 3], "power": np.zeros((1, 2), complex)},
            "power takes 2 real numbers, one a row of xyz, not complex128 of shape (1, 2)",
        ),
        (
            {"xyz": TABLE[:, :3], "velocity": [0, np.nan]},
            "row 2: column v is NaN; expected a finite number",
        ),
    ],
)
def test_a_faulty_npz_or_mat_is_refused(
    save: Callable[..., Path], named: dict[str, Any], message: str
) -> None:
    assert refusal(save(**named)) == message


def test_a_mat_of_structures_and_cells_names_what_it_holds(tmp_path: Path) -> None:
    savemat(tmp_path / "cloud.mat", {"s": {"xyz": TABLE}, "c": np.array([TABLE, "a"], dtype=object)})
    assert refusal(tmp_path / "cloud.mat").startswith(f"{ARRAYS}; it holds s/xyz (")


def test_a_mat73_of_other_variables_than_numbers_names_their_classes(tmp_path: Path) -> None:
    path = tmp_path / "cloud.mat"
    write_mat73(path, label="street", phases=np.ones((2, 4), complex))
    with h5py.File(path, "a") as file:
        file.create_dataset("cell", (2, 1), h5py.ref_dtype).attrs["MATLAB_class"] = np.bytes_("cell")
        put_mat73(file, "names", np.ones((6, 4), np.uint32))
        file["names"].attrs["MATLAB_class"] = np.bytes_("string")
        for name, attribute in (("structure", "MATLAB_fields"), ("zeros", "MATLAB_sparse")):
            put_mat73(file, f"{name}/xyz", TABLE)
            file[name].attrs["MATLAB_class"] = np.bytes_("struct")
            file[name].attrs[attribute] = np.uint64(2)
    assert refusal(path) == (
        f"{ARRAYS}; it holds cell (cell), label (char), names (string), phases (complex128 of shape (2, 4)), "
        "structure/xyz (float64 of shape (2, 5)), zeros (sparse matrix)"
    )


def test_a_mat73_of_another_program_is_read_in_the_order_of_its_file(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "cloud.mat", "w") as file:
        file["cloud"] = TABLE
    assert np.array_equal(PointCloud.read(tmp_path / "cloud.mat").to_array(), TABLE)


# ply


def ply_bytes(order: str, rows: np.ndarray, extra: str = "") -> bytes:
    """A foreign binary PLY: mixed types, a colour, a fixed-size element before and a list after."""
    header = (
        f"ply\nformat binary_{order}_endian 1.0\ncomment by hand\n{extra}"
        "element sensor 2\nproperty short id\nproperty double gain\n"
        f"element vertex {len(rows)}\nproperty float64 x\nproperty double y\nproperty uchar red\n"
        "property double z\nproperty float velocity\n"
        "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    )
    sign = "<" if order == "little" else ">"
    sensors = np.zeros(2, [("id", f"{sign}i2"), ("gain", f"{sign}f8")])
    layout = [("x", f"{sign}f8"), ("y", f"{sign}f8"), ("red", "u1"), ("z", f"{sign}f8"), ("v", f"{sign}f4")]
    vertices = np.zeros(len(rows), layout)
    for index, name in enumerate("xyzv"):
        vertices[name] = rows[:, index]
    return header.encode() + sensors.tobytes() + vertices.tobytes() + b"\x03\0\0\0\0"


@pytest.mark.parametrize("order", ["little", "big"])
def test_a_foreign_binary_ply_is_read(tmp_path: Path, order: str) -> None:
    path = tmp_path / "cloud.ply"
    path.write_bytes(ply_bytes(order, TABLE))
    assert np.array_equal(PointCloud.read(path).to_array(), np.column_stack([TABLE[:, :4], [1, 1]]))


def test_a_foreign_ascii_ply_is_read(tmp_path: Path) -> None:
    text = (
        "ply\r\nformat ascii 1.0\r\nobj_info x\r\nelement sensor 1\r\nproperty list uchar int ids\r\n"
        "element vertex 2\r\nproperty float power\r\nproperty float v\r\nproperty uchar red\r\n"
        "property float z\r\nproperty float y\r\nproperty float x\r\nelement face 1\r\n"
        "property list uchar int vertex_indices\r\nend_header\r\n"
        "2 7 8\r\n0.5 4 255 3 2 1\r\n2 8 255 7 6 5\r\n3 0 1 1\r\n"
    )
    path = tmp_path / "cloud.ply"
    path.write_bytes(text.encode())
    assert PointCloud.read(path).to_array().tolist() == [[1, 2, 3, 4, 0.5], [5, 6, 7, 8, 2]]


@pytest.mark.parametrize("name", POWERS)
def test_a_ply_with_a_power_under_another_name_is_refused(tmp_path: Path, name: str) -> None:
    name = name.replace("Power", "Powers")  # which is power itself in tables, where case makes no difference
    text = f"{HEAD}{PROPERTIES}property float scalar_{name}\nend_header\n1 2 3 4 5\n1 2 3 4 5\n"
    assert refusal(text_file(tmp_path, "a.ply", text)).startswith(
        f"has no power, but scalar_{name}; {NO_POWER}"
    )


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian"])
def test_a_mesh_with_a_texture_is_no_cloud(tmp_path: Path, form: str) -> None:
    """A triangle of x, y, z, u, v, as Mitsuba writes it."""
    header = f"ply\nformat {form} 1.0\nelement vertex 3\n" + "".join(
        f"property float {name}\n" for name in "xyzuv"
    )
    header += "element face 1\nproperty list uchar int vertex_index\nend_header\n"
    rows = np.array([[0, 0, 0, 0, 0], [1, 0, 0, 1, 0], [0, 1, 0, 0, 1]], "<f4")
    face = b"\x03" + np.arange(3, dtype="<i4").tobytes()
    text = "".join(f"{' '.join(map(str, row))}\n" for row in rows.tolist()).encode() + b"3 0 1 2\n"
    body = text if form == "ascii" else rows.tobytes() + face
    (tmp_path / "mesh.ply").write_bytes(header.encode() + body)
    assert (
        refusal(tmp_path / "mesh.ply") == f"element vertex: v beside u is of a texture; {TAKES} x, y, z, u, v"
    )
    for name in ("U", "tu", "texture_u", "s"):
        (tmp_path / "mesh.ply").write_bytes(header.replace("float u\n", f"float {name}\n").encode() + body)
        assert refusal(tmp_path / "mesh.ply").startswith(f"element vertex: v beside {name} is of a texture")
    (tmp_path / "cloud.ply").write_bytes(header.encode().replace(b"float v\n", b"float velocity\n") + body)
    assert PointCloud.read(tmp_path / "cloud.ply").velocity.tolist() == [0, 0, 1]


@pytest.mark.parametrize("order", ["little", "big"])
def test_a_binary_ply_cut_off_is_refused(tmp_path: Path, order: str) -> None:
    path = tmp_path / "cloud.ply"
    data = ply_bytes(order, TABLE)
    whole = len(data) - 5
    for length in range(whole):
        path.write_bytes(data[:length])
        with pytest.raises(InputError):
            PointCloud.read(path)
    path.write_bytes(data[: whole - 1])
    assert refusal(path) == "is truncated: 1 of 2 vertices"


def test_a_binary_ply_with_a_list_before_the_vertices_is_refused(tmp_path: Path) -> None:
    header = ply_bytes("little", TABLE).replace(b"property short id", b"property list uchar int id")
    (tmp_path / "cloud.ply").write_bytes(header)
    assert (
        refusal(tmp_path / "cloud.ply") == "has lists before its vertices, which only an ASCII file may have"
    )


HEAD = "ply\nformat ascii 1.0\nelement vertex 2\n"
PROPERTIES = "property float x\nproperty float y\nproperty float z\nproperty float v\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "row 1: is not a PLY file, which starts with 'ply'"),
        ("x,y,z,v\n", "row 1: is not a PLY file, which starts with 'ply'"),
        (HEAD + PROPERTIES, "the header has no line 'end_header'; is the file truncated?"),
        ("ply\nelement vertex 0\nend_header\n", "the header has no line 'format'"),
        ("ply\nformat ascii 2.0\n", "row 2: 'format ascii 2.0' does not belong in a PLY 1.0 header"),
        (HEAD + "property half x\n", "row 4: 'property half x' does not belong in a PLY 1.0 header"),
        ("ply\nproperty float x\n", "row 2: 'property float x' does not belong in a PLY 1.0 header"),
        ("ply\nelement vertex -1\n", "row 2: 'element vertex -1' does not belong in a PLY 1.0 header"),
        (HEAD + "property float x\nproperty float x\n", "row 5: property x appears twice"),
        ("ply\nformat ascii 1.0\nend_header\n", "has no element 'vertex'; its elements: none"),
        (
            HEAD + "property float x\nproperty float y\nend_header\n",
            f"element vertex: z is missing; {TAKES} x, y",
        ),
        (HEAD + "end_header\n", f"element vertex: x is missing; {TAKES} none"),
        (HEAD + "format ascii 1.0\n", "row 4: line format appears twice"),
        (HEAD + "element vertex 2\n", "row 4: element vertex appears twice"),
        (
            HEAD + PROPERTIES + "property float velocity\nend_header\n",
            f"element vertex: v appears twice, as v and velocity; {TAKES} x, y, z, v, velocity",
        ),
        (
            HEAD + PROPERTIES + "property list uchar int ids\nend_header\n",
            "element vertex: has a list property; only plain ones can be read",
        ),
        (HEAD + PROPERTIES + "end_header\n1 2 3 4\n", "is truncated: 1 of 2 vertices"),
        (
            HEAD + PROPERTIES + "end_header\n1 2 3 4\n1 2 3\n",
            "row 10: 3 fields instead of 4 (x, y, z, v)",
        ),
        (
            HEAD + PROPERTIES + "end_header\n1 2 3 4\n1 2 x 3\n",
            "row 10: column z is 'x'; expected a number",
        ),
        (
            HEAD + PROPERTIES + "end_header\n1 2 3 4\n1 2 3 1_0\n",
            "row 10: column v is '1_0'; expected a number",
        ),
        (
            HEAD + PROPERTIES + "end_header\n1 2 3 4\n１ 2 3 4\n",
            "row 10: column x is '\ufffd\ufffd\ufffd'; expected a number",
        ),
        (
            HEAD + PROPERTIES + "end_header\n1 2 3 4\n1\u00a02 3 4\n",
            "row 10: 3 fields instead of 4 (x, y, z, v)",
        ),
        (
            HEAD + PROPERTIES + "end_header\n1 2 3 4\n1 2 3 4\n\n1 2 3 4\n",
            "row 12: is one too many; the header allows 2",
        ),
        (
            HEAD + "property float u\n" + PROPERTIES + "end_header\n",
            f"element vertex: v beside u is of a texture; {TAKES} u, x, y, z, v",
        ),
    ],
)
def test_a_faulty_ply_is_refused_with_its_place(tmp_path: Path, text: str, message: str) -> None:
    assert refusal(text_file(tmp_path, "cloud.ply", text)) == message


def test_the_table_of_a_cloud_is_what_pandas_reads_of_its_csv_file(tmp_path: Path) -> None:
    cloud = PointCloud.from_array(TABLE)
    cloud.write(tmp_path / "cloud.csv")
    pd.testing.assert_frame_equal(cloud.to_dataframe(), pd.read_csv(tmp_path / "cloud.csv"))
    assert PointCloud.empty().to_dataframe().columns.tolist() == ["x", "y", "z", "v", "power"]


# As other programs write them


ROWS = [[1.5, 2.0, 3.0, -4.0, 0.5], [5.0, 6.0, 7.25, 8.0, 2.0]]
XYZ_ONE = [[1.5, 2.0, 3.0], [5.0, 6.0, 7.25]]

CSV_OF = {
    "pandas to_csv": ",x,y,z,v,power\n0,1.5,2.0,3.0,-4.0,0.5\n1,5.0,6.0,7.25,8.0,2.0\n",
    "pandas read and written again": "Unnamed: 0,x,y,z,v,power\n0,1.5,2,3,-4,.5\n1,5,6,7.25,8,2\n",
    "R write.csv": '"","x","y","z","v","power"\n"1",1.5,2,3,-4,0.5\n"2",5,6,7.25,8,2\n',
    "R write.csv2": '"";"x";"y";"z";"v";"power"\n"1";1,5;2;3;-4;0,5\n"2";5;6;7,25;8;2\n',
    "R write.table": '"x" "y" "z" "v" "power"\n"1" 1.5 2 3 -4 0.5\n"2" 5 6 7.25 8 2\n',
    "R write.table of some rows": '"x" "y" "z" "v" "power"\n"3" 1.5 2 3 -4 0.5\n"9" 5 6 7.25 8 2\n',
    "R write.table without quotes": "x y z v power\n1 1.5 2 3 -4 0.5\n2 5 6 7.25 8 2\n",
    "R with named rows": 'x,y,z,v,power\n"a",1.5,2,3,-4,0.5\n"b, c",5,6,7.25,8,2\n',
    "R row.names=FALSE": '"velocity","x","y","z","power"\n-4,1.5,2,3,0.5\n8,5,6,7.25,2\n',
    "quoted numbers": '"x","y","z","v","power"\n"1.5","2","3","-4","0.5"\n"5","6","7.25","8","2"\n',
    "R write.table with all quotes": (
        '"x" "y" "z" "v" "power"\n"1" "1.5" "2" "3" "-4" "0.5"\n"2" "5" "6" "7.25" "8" "2"\n'
    ),
    "R write.table with decimal commas": ('"x" "y" "z" "v" "power"\n"1" 1,5 2 3 -4 0,5\n"2" 5 6 7,25 8 2\n'),
    "tabs and decimal commas": "x\ty\tz\tv\tpower\n1,5\t2\t3\t-4\t0,5\n5\t6\t7,25\t8\t2\n",
    "tabs and decimal commas alone": "1,5\t2\t3\t-4\t0,5\n5\t6\t7,25\t8\t2\n",
    "commas and tabs": "x,\ty,\tz,\tv,\tpower\n1.5,\t2,\t3,\t-4,\t.5\n5,\t6,\t7.25,\t8,\t2\n",
    "commas in a text": "x;y;z;v;power;label\n1.5;2;3;-4;.5;3,4\n5;6;7.25;8;2;a\n",
    "tabs": "\tx\ty\tz\tv\tpower\n0\t1.5\t2\t3\t-4\t0.5\n1\t5\t6\t7.25\t8\t2\n",
    "Excel with its separator": "\ufeffsep=;\r\nx;y;z;v;power\r\n1,5;2;3;-4;0,5\r\n5;6;7,25;8;2\r\n",
    "CloudCompare with the number of points": "//X Y Z V Power\n2\n1.5 2 3 -4 0.5\n5 6 7.25 8 2\n",
    "semicolons": "x;y;z;v;power\n1.5;2;3;-4;0.5\n5;6;7.25;8;2\n",
    "a byte order mark": "\ufeffx,y,z,v,power\r\n1.5,2,3,-4,0.5\r\n5,6,7.25,8,2\r\n",
    "carriage returns": "x,y,z,v,power\r1.5,2,3,-4,0.5\r5,6,7.25,8,2\r",
    "other columns": "t,x,y,z,label,v,power,snr\na,1.5,2,3,a b,-4,0.5,1\nb,5,6,7.25,1_0,8,2,\n",
    "CloudCompare": "//X Y Z V Power\n1.5 2 3 -4 0.5\n5 6 7.25 8 2\n",
    "numpy.savetxt": "# x,y,z,v,power\n1.5e+00,2,3,-4,0.5\n5,6,7.25,8,2\n",
    "names in another order": "# power v z y x\n0.5 -4 3 2 1.5\n2 8 7.25 6 5\n",
    "comments": "# made by hand\nx,y,z,v,power\n1.5,2,3,-4,0.5\n// half\n5,6,7.25,8,2\n# end\n",
    "blanks": " 1.5  2 3 -4 0.5 \n5 6 7.25\t8 2\n",
}


@pytest.mark.parametrize("text", CSV_OF.values(), ids=CSV_OF)
def test_a_csv_is_read_as_other_programs_write_it(tmp_path: Path, text: str) -> None:
    assert PointCloud.read(text_file(tmp_path, "cloud.csv", text)).to_array().tolist() == ROWS


@few
@given(table=st.integers(0, 6).flatmap(lambda n: arrays(np.float64, (n, 5), elements=finite)))
def test_what_pandas_writes_of_a_cloud_is_read_exactly(table: np.ndarray) -> None:
    frame = PointCloud.from_array(table).to_dataframe()
    with TemporaryDirectory() as folder:
        path = Path(folder) / "cloud.csv"
        for options in ({}, {"sep": ";", "decimal": ","}, {"sep": "\t"}, {"index": False}):
            frame.to_csv(path, **options)
            assert PointCloud.read(path).to_array().tobytes() == table.tobytes()


NAMES = f"allowed are the names x, y, z ... and {NO_NUMBERS}"
AMBIGUOUS = {
    "0,1.5,2,3\n1,4,5,6\n": "the first column may number the rows, and may be x as well; ",
    "1 1.5 2 3\n2 4 5 6\n": "the first column may number the rows, and may be x as well; ",
    "9,1.5,2,3\n4,4,5,6\n": "the first column may number the rows, and may be x as well; ",
    "1.0,2,3,4\n2.0,4,5,6.5\n": "the first column may number the rows, and may be x as well; ",
    '"7" 1 2 3\n"9" 4 5 6\n': "the first column may number the rows, and may be x as well; ",
    '"1",1.5,2,3,4\n"2",4,5,6,7\n': "the first column may number the rows, and may be x as well; ",
    "0,1,2,3\n7,4,5,6\n": "row 1: may be a header that numbers the columns; allowed are the names x, y, z",
    ",0,1,2\n0,1.5,2,3\n": "row 1: may be a header that numbers the columns; allowed are the names x, y, z",
    ",0,1,2,3,4\n0,7,4,5,6,7\n": f"row 1: may be a header that numbers the columns; {NAMES}",
    "# columns: v x y z\n7,4,5,6\n": "the comment 'columns: v x y z' may name the 4 columns; ",
    "# x y z power snr\n7,4,5,6\n": "the comment 'x y z power snr' may name the 4 columns; ",
}


@pytest.mark.parametrize(("text", "message"), AMBIGUOUS.items())
def test_a_csv_that_can_be_read_in_two_ways_is_refused(tmp_path: Path, text: str, message: str) -> None:
    assert refusal(text_file(tmp_path, "cloud.csv", text)).startswith(message)


def test_rows_without_a_header_whose_x_is_written_as_a_float_are_no_count(tmp_path: Path) -> None:
    path = text_file(tmp_path, "cloud.csv", "0.0,1,2,3\n1.0,4,5,6\n")
    assert PointCloud.read(path).xyz.tolist() == [[0, 1, 2], [1, 4, 5]]


def test_many_rows_are_read_and_refused_by_their_place(tmp_path: Path) -> None:
    """More than are held as texts at once."""
    table = np.random.default_rng(1).normal(size=(70_000, 4)) * 1e-300
    path = tmp_path / "cloud.csv"
    pd.DataFrame(table).to_csv(path, header=False, index=False)
    assert np.array_equal(PointCloud.read(path).to_array()[:, :4], table)
    with path.open("a") as file:
        file.write("1,2,inf,4\n")
    assert refusal(path) == "row 70001: column z is infinite; expected a finite number"


def test_points_of_a_scenario_are_read_as_pandas_and_r_write_them(tmp_path: Path) -> None:
    for text in (
        ",x,y,z,v,amplitude\n0,1,2,3,4,0.5\n",
        '"";"X";"Y";"Z";"velocity";"amplitude"\n"1";1;2;3;4;0,5\n',
    ):
        points = read_points_csv(text_file(tmp_path, "points.csv", text))
        assert (points.xyz.tolist(), points.velocity.tolist(), points.amplitude.tolist()) == (
            [[1, 2, 3]],
            [4],
            [0.5],
        )


@pytest.mark.parametrize("ends", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("mark", [b"", b"\xef\xbb\xbf"])
@pytest.mark.parametrize("names", ["x y z v power", "x y z scalar_v scalar_power", "x y z velocity power"])
def test_an_ascii_ply_is_read_with_any_ends_of_lines_and_blank_lines(
    tmp_path: Path, ends: str, mark: bytes, names: str
) -> None:
    lines = [
        "ply",
        "format ascii 1.0",
        "comment Author: CloudCompare",
        "",
        "obj_info Generated by CloudCompare",
    ]
    lines += [
        "comment end_header",
        "element vertex 2",
        *(f"property double {name}" for name in names.split()),
    ]
    lines += ["end_header", *(" ".join(map(str, row)) for row in ROWS), ""]
    path = tmp_path / "cloud.ply"
    path.write_bytes(mark + ends.join(lines).encode())
    assert PointCloud.read(path).to_array().tolist() == ROWS


@pytest.mark.parametrize("ends", [b"\n", b"\r\n", b"\r"])
def test_a_binary_ply_begins_behind_the_end_of_a_line_of_its_header(tmp_path: Path, ends: bytes) -> None:
    header = b"ply\nformat binary_little_endian 1.0\nelement vertex 1\nproperty uchar red\n"
    header += b"property double x\nproperty double y\nproperty double z\nend_header\n"
    path = tmp_path / "cloud.ply"
    for first in (b"\n", b"\r", b"e"):
        path.write_bytes(header.replace(b"\n", ends) + first + np.array([1.0, 2, 3]).tobytes())
        assert PointCloud.read(path).xyz.tolist() == [[1, 2, 3]]


@pytest.mark.parametrize("extra", [[], ["double nx", "double ny", "double nz"], ["uchar red", "uchar green"]])
def test_a_ply_of_open3d_is_a_cloud_without_velocities(tmp_path: Path, extra: list[str]) -> None:
    properties = ["double x", "double y", "double z", *extra]
    header = "ply\nformat binary_little_endian 1.0\ncomment Created by Open3D\nelement vertex 2\n"
    header += "".join(f"property {one}\n" for one in properties) + "end_header\n"
    types = {"double": "<f8", "uchar": "u1"}
    vertices = np.zeros(2, [(one.split()[1], types[one.split()[0]]) for one in properties])
    for axis, values in zip("xyz", np.transpose(XYZ_ONE), strict=True):
        vertices[axis] = values
    path = tmp_path / "cloud.ply"
    path.write_bytes(header.encode() + vertices.tobytes())
    assert_without_velocity(PointCloud.read(path))


@pytest.mark.parametrize("encoding", ["ascii", "binary"])
def test_a_ply_of_trimesh_is_a_cloud_without_velocities(tmp_path: Path, encoding: str) -> None:
    trimesh = pytest.importorskip("trimesh")
    cloud = trimesh.PointCloud(XYZ_ONE, colors=[[1, 2, 3, 255]] * 2)
    (tmp_path / "cloud.ply").write_bytes(cloud.export(file_type="ply", encoding=encoding))
    assert_without_velocity(PointCloud.read(tmp_path / "cloud.ply"))


def test_faces_of_several_lengths_behind_the_vertices_do_no_harm(tmp_path: Path) -> None:
    header = "ply\nformat binary_little_endian 1.0\nelement vertex 2\n"
    header += "".join(f"property double {axis}\n" for axis in "xyz")
    header += "element face 2\nproperty list uchar uchar vertex_indices\nend_header\n"
    body = np.array(XYZ_ONE).tobytes() + b"\3\0\1\1\4\0\1\1\0"
    (tmp_path / "mesh.ply").write_bytes(header.encode() + body)
    assert_without_velocity(PointCloud.read(tmp_path / "mesh.ply"))


# Without velocities


def assert_without_velocity(cloud: PointCloud, power: tuple[float, float] = (1, 1)) -> None:
    assert cloud.xyz.tolist() == XYZ_ONE
    assert not cloud.has_velocity
    assert np.isnan(cloud.velocity).all()
    assert tuple(cloud.power) == power


@pytest.mark.parametrize("suffix", FORMATS)
def test_a_cloud_without_velocities_is_written_and_read_as_such(tmp_path: Path, suffix: str) -> None:
    for power in (None, [0.5, 2]):
        cloud = PointCloud(XYZ_ONE, power=power)
        path = tmp_path / f"cloud.{suffix}"
        if suffix == "npy" and power:
            with pytest.raises(InputError, match="npy has no place for powers without velocities"):
                cloud.write(path)
            continue
        cloud.write(path)
        assert_without_velocity(PointCloud.read(path), tuple(cloud.power))


def test_points_alone_are_a_cloud_without_velocities(save: Callable[..., Path]) -> None:
    for named in ({"xyz": XYZ_ONE}, {"points": XYZ_ONE}):
        assert_without_velocity(PointCloud.read(save(**{k: np.array(v) for k, v in named.items()})))


@pytest.mark.parametrize(
    "text",
    [
        "x,y,z\n1.5,2,3\n5,6,7.25\n",
        "1.5 2 3\n5 6 7.25\n",
        "//X Y Z R\n1.5 2 3 9\n5 6 7.25 9",
        "level_0,level_1,__index_level_0__,x,y,z\n0,1,0,1.5,2,3\n0,2,1,5,6,7.25\n",
    ],
)
def test_a_csv_of_points_alone_is_a_cloud_without_velocities(tmp_path: Path, text: str) -> None:
    assert_without_velocity(PointCloud.read(text_file(tmp_path, "cloud.csv", text)))
