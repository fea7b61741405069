"""Checks of a plugin with a part of its source replaced."""

from isacbench.checking.plugin_check import check_plugin
from isacbench.plugins.discovery import PluginFile, isolated_plugins, register_plugin
from isacbench.plugins.registry import registered


def indented(code):
    """Statements of a method."""
    return "".join(f"        {line}\n" for line in code.split("\n"))


def findings_of(kind, name):
    return {finding.check: finding for finding in check_plugin(registered(kind, name))}


def findings_of_changed(kind, source, old="", new=""):
    """Findings by check of the plugin `broken`, a part of its source replaced once."""
    assert old in source
    with isolated_plugins():
        register_plugin(PluginFile("broken.py", source.replace(old, new, 1) if old else source))
        return findings_of(kind, "broken")


def failed(findings):
    return {name for name, finding in findings.items() if finding.status == "failed"}
