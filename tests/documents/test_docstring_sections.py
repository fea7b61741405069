"""Docstrings name the thing first, and those of public functions describe arguments and results."""

import ast
import re

from tests.documents.sources import FILES, trees

QUESTION = re.compile(r"(What|Which|Whether|How|Where|Who|Whose|Why|When|That)\b")
NO_SECTIONS = ("overload", "validator", "property", ".command")  # decorators


def definitions(node, prefix="", public=True):
    """Yields the classes and functions of a module and of its classes, and whether others may use them."""
    for child in node.body:
        if isinstance(child, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            is_public = public and not child.name.startswith("_")
            yield prefix + child.name, child, is_public
            if isinstance(child, ast.ClassDef):
                yield from definitions(child, f"{prefix}{child.name}.", is_public)


def has_arguments(function):
    given = function.args
    names = [one.arg for one in (*given.posonlyargs, *given.args, *given.kwonlyargs)]
    return bool({*names} - {"self", "cls"} or given.vararg or given.kwarg)


def wants_sections(module, function):
    decorators = " ".join(map(ast.unparse, function.decorator_list))
    is_command = FILES[module].parent.name == "cli" and function.name.endswith(
        "_command"
    )  # its docstring is its help
    return has_arguments(function) and not is_command and not any(word in decorators for word in NO_SECTIONS)


def test_no_docstring_opens_with_a_question():
    offences = [
        f"{module} {name}: {text.splitlines()[0]}"
        for module, tree in trees().items()
        for name, node, _ in [("", tree, True), *definitions(tree)]
        if (text := ast.get_docstring(node)) and QUESTION.match(text)
    ]
    assert offences == []


def test_public_functions_with_arguments_describe_them_and_what_they_return():
    offences = []
    for module, tree in trees().items():
        for name, node, is_public in definitions(tree):
            if isinstance(node, ast.ClassDef) or not is_public or not wants_sections(module, node):
                continue
            text = ast.get_docstring(node) or ""
            returns = ast.unparse(node.returns) if node.returns else "None"
            if "Parameters\n---" not in text:
                offences.append(f"{module} {name}: Parameters")
            if returns not in ("None", "NoReturn") and not re.search(r"(Returns|Yields)\n---", text):
                offences.append(f"{module} {name}: Returns")
    assert offences == []
