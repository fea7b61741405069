"""Point clouds in files: exact round trips, and files of other programs."""

from __future__ import annotations

import itertools
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.io import loadmat

from isacbench.errors import InputError
from isacbench.model.cloud import PointCloud
from isacbench.model.cloud_files.point_files import read_points_csv
from tests.conftest import few, refusal

from ...cubes.samples import mat, mat73, npz

FORMATS = ("csv", "npy", "npz", "mat", "ply")
TABLE = np.array([[1.0, 2, 3, 4, 0.5], [-0.1, 1 / 3, 1e-7, -3, 2.25]])
FINITE = st.floats(allow_nan=False, allow_infinity=False)
TABLES = st.integers(0, 6).flatmap(lambda n: arrays(np.float64, (n, 5), elements=FINITE))


def reason(path):
    """Message with which a file is refused, less its path."""
    message = refusal(PointCloud.read, path)
    assert message.startswith(f"{path}: ")
    return message.removeprefix(f"{path}: ")


@pytest.fixture
def read_csv(tmp_path):
    """Return a function that reads a text as a cloud, or as scatterers."""

    def read(text, reader=PointCloud.read):
        path = tmp_path / "cloud.csv"
        path.write_text(text, encoding="utf-8")
        return reader(path)

    return read


# Round trips


@pytest.mark.parametrize("suffix", FORMATS)
@few
@given(table=TABLES)
def test_a_round_trip_returns_the_same_doubles(suffix, table):
    cloud = PointCloud.from_array(table)
    with TemporaryDirectory() as folder:
        path = Path(folder) / f"cloud.{suffix}"
        cloud.write(path)
        found = PointCloud.read(path).to_array()
    assert np.array_equal(found, table)
    assert np.array_equal(np.signbit(found), np.signbit(table))


@pytest.mark.parametrize("suffix", FORMATS)
def test_writing_overwrites_and_takes_upper_case_and_strings(tmp_path, suffix):
    path = tmp_path / f"CLOUD.{suffix.upper()}"
    PointCloud.from_array(np.ones((50, 5))).write(path)
    PointCloud.from_array(TABLE).write(str(path))
    assert np.array_equal(PointCloud.read(str(path)).to_array(), TABLE)
    assert [found.name for found in tmp_path.iterdir()] == [path.name]


def test_written_files_name_their_columns(tmp_path):
    PointCloud.from_array(TABLE[:1]).write(tmp_path / "cloud.csv")
    assert (tmp_path / "cloud.csv").read_bytes() == b"x,y,z,v,power\n1.0,2.0,3.0,4.0,0.5\n"
    for suffix, load in (("mat", loadmat), ("npz", np.load)):
        PointCloud.from_array(TABLE).write(tmp_path / f"cloud.{suffix}")
        found = load(tmp_path / f"cloud.{suffix}")
        for name, columns in (("xyz", TABLE[:, :3]), ("velocity", TABLE[:, 3:4]), ("power", TABLE[:, 4:])):
            assert np.array_equal(found[name].reshape(columns.shape), columns)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("cloud.txt", r"has suffix '.txt'; a cloud takes \.csv, \.npy, \.npz, \.mat, \.ply$"),
        ("cloud", "has no suffix; a cloud takes"),
        *((f"folder.{suffix}", "cannot be written: Is a directory$") for suffix in FORMATS),
        *((f"nowhere/cloud.{suffix}", "cannot be written: No such file or directory$") for suffix in FORMATS),
    ],
)
def test_what_cannot_be_written_is_told(tmp_path, name, words):
    if name.startswith("folder"):
        (tmp_path / name).mkdir()
    with pytest.raises(InputError, match=f"^{tmp_path / name}: {words}"):
        PointCloud.empty().write(tmp_path / name)


# csv


def test_a_csv_may_have_no_rows_no_powers_and_no_header(read_csv):
    for text, rows in {
        "x,y,z,v,power\n": [],
        "x,y,z,v\n\n1,2,3,4\n\n5,6,7,8": [[1, 2, 3, 4, 1], [5, 6, 7, 8, 1]],
        "1,2,3,4\n5,6,7,8\n": [[1, 2, 3, 4, 1], [5, 6, 7, 8, 1]],
        "0.0,1,2,3\n1.0,4,5,6\n": [[0, 1, 2, 3, 1], [1, 4, 5, 6, 1]],  # x, and no count of rows
    }.items():
        assert read_csv(text).to_array().tolist() == rows


# Scatterers of a scenario


def test_scatterers_are_read_with_and_without_amplitude(read_csv):
    for text, amplitude in {
        "amplitude,x,y,z,v\n0.5,1,2,3,4\n": 0.5,
        "x,y,z,v\n1,2,3,4\n": 1,
        ",x,y,z,v,amplitude\n0,1,2,3,4,0.5\n": 0.5,
        '"";"X";"Y";"Z";"velocity";"amplitude"\n"1";1;2;3;4;0,5\n': 0.5,
    }.items():
        points = read_csv(text, read_points_csv)
        assert points.xyz.tolist() == [[1, 2, 3]]
        assert (points.velocity.tolist(), points.amplitude.tolist()) == ([4], [amplitude])


# npy, npz and mat


@pytest.fixture(params=[npz, mat, mat73])
def save(request, tmp_path):
    def write(**named):
        suffix, write_file = request.param(**named)
        path = tmp_path / f"cloud{suffix}"
        write_file(path)
        return path

    return write


PARTS = {"xyz": TABLE[:, :3], "velocity": TABLE[:, 3]}
ONES = np.column_stack([TABLE[:, :4], [1, 1]])
NAMED = [
    ({"whatever": TABLE}, TABLE),
    ({"settings": np.zeros((2, 3)), "label": np.array("street"), "estimate": TABLE}, TABLE),
    ({**PARTS, "power": TABLE[:, 4], "rcs": TABLE[:, 4] + 1}, TABLE),
    ({**PARTS, "velocity": TABLE[:, 3:4], "power": TABLE[:, 4:].T, "other": TABLE}, TABLE),
    ({"p": TABLE[:, :4]}, ONES),
    (PARTS, ONES),
    ({**PARTS, "power_dbm": 20.0, "power_unit": "1", "label": np.array([3, 4])}, ONES),
    *(({"table": np.ones((3, 4), dtype)}, np.ones((3, 5))) for dtype in ("f4", "u2", "i8")),
]


def test_npz_and_mat_are_read_as_parts_or_as_the_only_table(save):
    for named, rows in NAMED:
        assert np.array_equal(PointCloud.read(save(**named)).to_array(), rows), named


# ply


def ply_bytes(order, rows):
    """A foreign binary PLY: mixed types, a colour and a list after."""
    header = (
        f"ply\nformat binary_{order}_endian 1.0\ncomment by hand\n"
        f"element vertex {len(rows)}\nproperty float64 x\nproperty double y\nproperty uchar red\n"
        "property double z\nproperty float velocity\n"
        "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    )
    sign = "<" if order == "little" else ">"
    layout = [("x", f"{sign}f8"), ("y", f"{sign}f8"), ("red", "u1"), ("z", f"{sign}f8"), ("v", f"{sign}f4")]
    vertices = np.array([(x, y, 0, z, v) for x, y, z, v, _ in rows], layout)
    return header.encode() + vertices.tobytes() + b"\x03\0\0\0\0"


@pytest.mark.parametrize("order", ["little", "big"])
def test_a_foreign_binary_ply_is_read_as_a_whole_or_not_at_all(tmp_path, order):
    path, data = tmp_path / "cloud.ply", ply_bytes(order, TABLE)
    path.write_bytes(data)
    assert np.array_equal(PointCloud.read(path).to_array(), np.column_stack([TABLE[:, :4], [1, 1]]))
    path.write_bytes(data[:-6])
    assert reason(path) == "is truncated: 1 of 2 vertices"


def test_a_mesh_with_a_texture_is_no_cloud(tmp_path):
    """Points of x, y, z, u, v, as Mitsuba writes them."""
    header = "ply\nformat ascii 1.0\nelement vertex 1\n"
    header += "".join(f"property float {name}\n" for name in "xyzuv") + "end_header\n1 2 3 4 5\n"
    path = tmp_path / "mesh.ply"
    for name in ("u", "U", "tu", "texture_u", "s"):
        path.write_text(header.replace("float u\n", f"float {name}\n"))
        assert reason(path).startswith(f"element vertex: v beside {name} is of a texture")
    path.write_text(header.replace("float v\n", "float velocity\n"))
    assert PointCloud.read(path).velocity.tolist() == [5]


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
    "R write.table with all quotes": '"x" "y" "z" "v" "power"\n1 "1.5" "2" "3" "-4" ".5"\n2 5 6 7.25 8 "2"\n',
    "R write.table with decimal commas": '"x" "y" "z" "v" "power"\n"1" 1,5 2 3 -4 0,5\n"2" 5 6 7,25 8 2\n',
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
    "comments": "# made by hand\nx,y,z,v,power\n1.5,2,3,-4,0.5\n5,6,7.25,8,2\n",
    "blanks": " 1.5  2 3 -4 0.5 \n5 6 7.25\t8 2\n",
}


def test_a_csv_is_read_as_other_programs_write_it(read_csv):
    for program, text in CSV_OF.items():
        assert read_csv(text).to_array().tolist() == ROWS, program


@few
@given(table=TABLES)
def test_what_pandas_writes_of_a_cloud_is_read_exactly(table):
    frame = PointCloud.from_array(table).to_dataframe()
    with TemporaryDirectory() as folder:
        path = Path(folder) / "cloud.csv"
        for options in ({}, {"sep": ";", "decimal": ","}, {"sep": "\t"}, {"index": False}):
            frame.to_csv(path, **options)
            assert PointCloud.read(path).to_array().tobytes() == table.tobytes()


def test_many_rows_are_read_and_refused_by_their_place(tmp_path):
    table = np.random.default_rng(1).normal(size=(7_000, 4)) * 1e-300
    path = tmp_path / "cloud.csv"
    pd.DataFrame(table).to_csv(path, header=False, index=False)
    assert np.array_equal(PointCloud.read(path).to_array()[:, :4], table)
    with path.open("a") as file:
        file.write("1,2,inf,4\n")
    assert reason(path) == "row 7001: column z is inf; expected a finite number"


@pytest.mark.parametrize("names", ["x y z v power", "x y z scalar_v scalar_power", "x y z velocity power"])
def test_an_ascii_ply_is_read_with_any_ends_of_lines_and_blank_lines(tmp_path, names):
    path = tmp_path / "cloud.ply"
    lines = ["ply", "format ascii 1.0", "comment Author: CloudCompare", "", "obj_info by CloudCompare"]
    lines += ["comment end_header", "element vertex 2"]
    lines += [f"property double {name}" for name in names.split()]
    lines += ["property uchar red", "element face 1", "property list uchar int vertex_indices", "end_header"]
    lines += [*(" ".join(map(str, [*row, 255])) for row in ROWS), "", "3 0 1 1"]
    for ends, mark in itertools.product(["\n", "\r\n"], [b"", b"\xef\xbb\xbf"]):
        path.write_bytes(mark + ends.join(lines).encode())
        assert PointCloud.read(path).to_array().tolist() == ROWS


@pytest.mark.parametrize("encoding", ["ascii", "binary"])
def test_a_ply_of_trimesh_is_a_cloud_without_velocities(tmp_path, encoding):
    trimesh = pytest.importorskip("trimesh")
    cloud = trimesh.PointCloud(XYZ_ONE, colors=[[1, 2, 3, 255]] * 2)
    (tmp_path / "cloud.ply").write_bytes(cloud.export(file_type="ply", encoding=encoding))
    assert_without_velocity(PointCloud.read(tmp_path / "cloud.ply"))


# Without velocities


def assert_without_velocity(cloud, power=(1, 1)):
    assert cloud.xyz.tolist() == XYZ_ONE
    assert not cloud.has_velocity
    assert np.isnan(cloud.velocity).all()
    assert tuple(cloud.power) == power


@pytest.mark.parametrize("suffix", FORMATS)
def test_a_cloud_without_velocities_is_written_and_read_as_such(tmp_path, suffix):
    for power in (None, [0.5, 2]):
        cloud = PointCloud(XYZ_ONE, power=power)
        path = tmp_path / f"cloud.{suffix}"
        if suffix == "npy" and power:
            with pytest.raises(InputError, match="npy has no place for powers without velocities"):
                cloud.write(path)
            continue
        cloud.write(path)
        assert_without_velocity(PointCloud.read(path), tuple(cloud.power))


def test_points_alone_are_a_cloud_without_velocities(save):
    for name in ("xyz", "points"):
        assert_without_velocity(PointCloud.read(save(**{name: np.array(XYZ_ONE)})))


def test_a_csv_of_points_alone_is_a_cloud_without_velocities(read_csv):
    for text in (
        "x,y,z\n1.5,2,3\n5,6,7.25\n",
        "1.5 2 3\n5 6 7.25\n",
        "//X Y Z R\n1.5 2 3 9\n5 6 7.25 9",
        "level_0,level_1,x,y,z\n0,1,1.5,2,3\n0,2,5,6,7.25\n",
    ):
        assert_without_velocity(read_csv(text))
