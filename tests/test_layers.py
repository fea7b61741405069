"""The house keeps its order: which package imports which, or names its modules in strings."""

import ast
import re
import tomllib
from functools import cache
from graphlib import CycleError, TopologicalSorter

import pytest

from tests.documents.sources import FILES, ROOT, statements, trees

APART = {
    "process_state": {"charts", "errors", "checkout", "choices", "cores"},
    "checked_arrays": {"charts", "checkout", "choices", "cores"},
    "display": {"specifications", "process_state", "checked_arrays"},
    "model": {"process_state"},
    "instrument": {"files", "display", "specifications", "process_state", "checked_arrays"},
    "metrics": {"files", "display", "specifications", "process_state", "instrument"},
    "dsp": {"specifications", "process_state"},
    "plugins": {"instrument"},
    "algorithms": {"files", "display", "specifications", "process_state"},
    "link": {"files", "specifications", "process_state", "instrument", "metrics", "plugins"},
    "cubes": {"display", "specifications", "process_state", "instrument", "metrics"},
    "bench": {"cubes"},
    "checking": {"link"},
    "report": {"process_state", "dsp"},
    "cli": {"display", "dsp"},
}
"""Packages below each package that it does not import."""

KNOWN = {
    ("isacbench.bench.cells.process", "isacbench.bench.cells.worker"),  # in workers
}
"""Rooms and modules whose strings name what stands above them, or imports them."""

NAMED = re.compile(r"(?:isacbench|isacbench_algorithms)(?:\.\w+)+(?::\w+)?")
ROOMS = {name for name, path in FILES.items() if path.name == "__init__.py"}


def imports(module):
    """Modules that a module imports, and the names taken from them, wherever the statement stands."""
    package = module if module in ROOMS else module.rpartition(".")[0]
    for node in statements(trees()[module]):
        if isinstance(node, ast.Import):
            yield from ((alias.name, None) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            above = package.split(".")[: len(package.split(".")) - node.level + 1] if node.level else []
            source = ".".join([*above, *([node.module] if node.module else [])])
            for alias in node.names:
                inner = f"{source}.{alias.name}"
                yield (inner, None) if inner in FILES else (source, alias.name)


@cache
def all_imports():
    """Modules of the library that each module imports, and the names taken from them."""
    return {
        name: [(source, taken) for source, taken in imports(name) if source in FILES and source != name]
        for name in FILES
    }


def named_modules(module):
    """Modules of the library that strings of a module name, as in ``package.module:function``."""
    docstrings = {id(node.body[0].value) for node in ast.walk(trees()[module]) if has_docstring(node)}
    texts = {
        node.value
        for node in ast.walk(trees()[module])
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in docstrings
    }
    for text in filter(NAMED.fullmatch, texts):
        parts = text.partition(":")[0].split(".")
        longer = (".".join(parts[:n]) for n in range(len(parts), 1, -1))
        yield from [name for name in longer if name in FILES][:1]


def has_docstring(node):
    own = ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef
    return isinstance(node, own) and bool(node.body) and isinstance(node.body[0], ast.Expr)


def inside(name, room):
    return f"{name}.".startswith(f"{room}.")


@cache
def all_strings():
    """Pairs of a module and one that a string in it names, those of the public names left out."""
    return {(name, other) for name in FILES if name != "isacbench" for other in named_modules(name)}


def known_by(module, other):
    """Exceptions that a pair falls under."""
    return {pair for pair in KNOWN if inside(module, pair[0]) and inside(other, pair[1])}


@cache
def all_names():
    """Modules of the library that each module imports, or names in a string to be imported later."""
    found = {name: {source for source, _ in all_imports()[name]} for name in FILES}
    for module, other in all_strings():
        if module != other and not known_by(module, other):
            found[module].add(other)
    return found


def exported(room):
    for node in trees()[room].body:
        is_list = isinstance(node, ast.Assign) and isinstance(node.value, ast.List)
        if is_list and getattr(node.targets[0], "id", "") == "__all__":
            return set(ast.literal_eval(node.value))
    return set()


def package_of(module):
    first, _, rest = module.partition(".")
    return rest.partition(".")[0] if first == "isacbench" else first.removeprefix("isacbench_")


def architecture(heading):
    """Section of the architecture page."""
    text = (ROOT / "docs" / "architecture.md").read_text("utf-8")
    return text.partition(f"## {heading}\n")[2].partition("##")[0]


def below_each():
    """Packages that each one may import: those of the floors below its own, but nobody the algorithms."""
    allowed, below = {"__main__": {"cli"}}, set()
    for line in reversed(re.findall(r"^ {4}(.+)", architecture("Floors"), re.MULTILINE)):
        floor = set(re.findall(r"\w+", line))
        allowed |= {package: below - APART.get(package, set()) for package in floor}
        below = below | floor - {"algorithms"}
    return allowed


def test_packages_import_and_name_only_what_lies_below_them():
    allowed = below_each()
    offences = [
        f"{module} imports {source}"
        for module, found in all_names().items()
        if module != "isacbench"  # which names the public names of all
        for source in found
        if package_of(source) not in {package_of(module), ""} | allowed[package_of(module)]
    ]
    assert not offences
    from_top = {name for module in FILES for source, name in all_imports()[module] if source == "isacbench"}
    assert from_top <= {None, "__version__"}  # whose other names come from every layer


def test_every_known_exception_is_still_needed():
    assert set().union(*(known_by(*pair) for pair in all_strings())) == KNOWN


def test_no_imports_go_in_a_circle_those_that_strings_name_included():
    graph = {name: found - {"isacbench"} for name, found in all_names().items()}
    for module, sources in graph.items():  # the packages above a module run before it
        above = {source[:end] for source in [*sources] for end in range(len(source)) if source[end] == "."}
        sources |= {room for room in above - {"isacbench"} if not f"{module}.".startswith(f"{room}.")}
    graph["isacbench"] = set()
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        pytest.fail(" -> ".join(error.args[1]))


def test_others_reach_into_no_module_that_a_room_keeps_for_itself():
    offences = []
    for module, found in all_imports().items():
        for source, taken in found:
            room, _, leaf = source.rpartition(".")
            if source in ROOMS or room in {"", "isacbench"}:
                if taken is not None and source in ROOMS - {"isacbench"} and taken not in exported(source):
                    offences.append(f"{module} takes {taken} from {source}, which does not name it")
                continue
            owner = room.rpartition(".")[0]
            inside = f"{module}.".startswith(f"{room}.") or module.rpartition(".")[0] == owner
            if not inside and leaf not in exported(room):
                offences.append(f"{module} imports {source}, which {room} keeps for itself")
    assert not offences


def test_rooms_name_what_exists():
    for room in ROOMS - {"isacbench", "isacbench_algorithms"}:
        bound = {name for _, name in all_imports()[room]} | {
            node.name for node in trees()[room].body if isinstance(node, ast.FunctionDef | ast.ClassDef)
        }
        for name in exported(room):
            assert name in bound or f"{room}.{name}" in FILES, f"{room} names {name}"


def test_rooms_alone_list_their_names():
    assert [module for module in FILES if module not in ROOMS and exported(module)] == []


DOTTED = re.compile(r"(?<![\w./-])(?:isacbench|isacbench_algorithms)(?:\.\w+)+")
SLASHED = re.compile(r"(?<![\w./-])(?:isacbench|algorithms|tests)/[\w/]+\.py\b")

NO_MODULES = {
    *("isacbench.estimators", "isacbench.detectors"),  # groups of entry points
    "figures/",  # in the folder of a run
    *("isacbench_algorithms.strongest", "algorithms/strongest.py"),  # the reader's, in CONTRIBUTING
}


SHORT = re.compile(r"`((?:\w+/)+\w+\.py|(?:\w+/)+)`")


def test_paths_in_documents_exist_in_the_library_or_beside_it():
    places = [ROOT, ROOT / "isacbench"]
    wrong = [
        f"{document.name}: {found}"
        for document in [*sorted((ROOT / "docs").glob("*.md")), ROOT / "README.md", ROOT / "CONTRIBUTING.md"]
        for found in SHORT.findall(document.read_text("utf-8"))
        if found not in NO_MODULES and not any((place / found).exists() for place in places)
    ]
    assert wrong == []


def written_paths():
    """Texts that name modules: code, its strings and docstrings, documents and settings."""
    for pattern in (
        "isacbench/**/*.py",
        "algorithms/*.py",
        "docs/*.md",
        "docs/scripts/*.py",
        "*.md",
        "pyproject.toml",
    ):
        for path in sorted(ROOT.glob(pattern)):
            if path.name != "CHANGELOG.md":
                yield path, path.read_text("utf-8")


@cache
def words_in(module):
    """Names, attributes and arguments of a module's code."""
    words = ("name", "id", "attr", "arg")
    return {getattr(node, word, None) for node in ast.walk(trees()[module]) for word in words}


@cache
def resolves(dotted):
    """Whether a dotted name is a module, or an attribute of one."""
    parts = dotted.split(".")
    for n in range(len(parts), 0, -1):
        module = ".".join(parts[:n])
        if module in FILES:
            if n == len(parts):
                return True
            return parts[n] in words_in(module) | exported(module) | {"__version__", "__file__", "__path__"}
    return False


def test_paths_that_are_written_down_exist():
    wrong = []
    for path, text in written_paths():
        for found in DOTTED.findall(text):
            if found not in NO_MODULES and not resolves(found):
                wrong.append(f"{path.relative_to(ROOT)}: {found}")
        wrong += [
            f"{path.relative_to(ROOT)}: {found}"
            for found in SLASHED.findall(text)
            if found not in NO_MODULES and not (ROOT / found).is_file()
        ]
    assert wrong == []


def test_the_architecture_page_draws_every_room_and_no_other():
    drawn, above = set(), []
    for indent, name in re.findall(r"^ {4}( *)([a-z_]+)/ ", architecture("The rooms"), re.MULTILINE):
        above = [*above[: len(indent) // 2], name]
        drawn.add(".".join(above))
    # Installed under a name of its own.
    drawn = {re.sub("^algorithms", "isacbench_algorithms", room) for room in drawn}
    assert {room for room in drawn if room.startswith("isacbench")} == ROOMS


def test_every_room_is_installed():
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
    assert {*settings["tool"]["setuptools"]["packages"]} == ROOMS | {"isacbench_scenarios"}
