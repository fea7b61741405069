import os

import pytest

from isacbench.bench.store.run_folder import default_folder, open_folder, replacing
from isacbench.errors import InputError


@pytest.mark.parametrize(
    ("name", "message"),
    [("thesis", "is not the folder of a run"), (".lock", "cannot be locked: Is a directory; use a folder")],
)
def test_a_folder_of_something_else_is_refused_and_left_alone(tmp_path, name, message):
    (tmp_path / name).mkdir()
    with pytest.raises(InputError, match=message), open_folder(tmp_path):
        pass
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_an_empty_existing_folder_is_taken_and_stays(tmp_path):
    with open_folder(tmp_path) as folder:
        assert folder == tmp_path
    assert tmp_path.is_dir()


def test_a_file_in_place_of_the_folder_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be created or read"), open_folder(tmp_path / "file"):
        pass


def test_a_new_folder_that_stays_empty_goes_away(tmp_path):
    with pytest.raises(RuntimeError), open_folder(tmp_path / "run"):
        raise RuntimeError
    assert not (tmp_path / "run").exists()


def test_a_folder_that_is_written_into_is_refused_with_who_does(tmp_path):
    with (
        open_folder(tmp_path / "run"),
        pytest.raises(InputError, match=rf"another run is writing into it \(process {os.getpid()} on "),
        open_folder(tmp_path / "run"),
    ):
        pass


def test_a_file_is_replaced_whole_or_not_at_all(tmp_path):
    path = tmp_path / "table.csv"
    path.write_text("old")
    with pytest.raises(UnicodeEncodeError), replacing(path) as temporary:
        temporary.write_text("half \ud800", encoding="utf-8")
    assert path.read_text() == "old"
    assert [file.name for file in tmp_path.iterdir()] == ["table.csv"]
    with replacing(path) as temporary:
        temporary.write_text("new")
    assert path.read_text() == "new"


def test_the_default_folder_is_named_after_suite_and_time():
    assert default_folder("quick").match("results/quick-20??????-??????")
