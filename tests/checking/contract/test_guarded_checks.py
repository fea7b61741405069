import pytest

from isacbench.checking.contract import check_names, check_plugin, guarded_checks
from isacbench.checking.contract.guarded_checks import check_guarded
from isacbench.plugins.discovery import PluginFile, isolated_plugins, register_plugin
from tests.conftest import estimator_source


def test_findings_are_those_of_this_process():
    guarded, here = check_guarded("detector", "ca"), check_plugin("detector", "ca")
    assert [(one.check, one.status) for one in guarded] == [(one.check, one.status) for one in here]


def test_a_check_that_runs_on_is_told_while_it_does(monkeypatch):
    monkeypatch.setattr(guarded_checks, "TOLD_S", 0.2)
    deed = "time.sleep(0.5 if observation.array.shape == (2, 2) else 0)"
    told = []
    with isolated_plugins():
        register_plugin(PluginFile("deadly.py", estimator_source("deadly", deed)))
        check_guarded("estimator", "deadly", tell=told.append)
    assert "2 x 2 array" in told
    assert told == [name for name in check_names("estimator") if name in told]


@pytest.mark.parametrize(
    ("deed", "message"),
    [
        ("os._exit(5)", "ends its process: the process exited with code 5"),
        ("os._exit(0)", "ends its process: the process exited with code 0"),
        ("os.kill(os.getpid(), signal.SIGKILL)", "ends its process: the process died by SIGKILL"),
        ("signal.pause()", "takes more than 2 s: does it hang?"),
    ],
)
def test_a_deadly_plugin_fails_the_check_that_it_dies_in_and_skips_the_rest(deed, message):
    with isolated_plugins():
        register_plugin(PluginFile("deadly.py", estimator_source("deadly", deed)))
        findings = check_guarded("estimator", "deadly", timeout_s=2)
    assert [finding.check for finding in findings] == check_names("estimator")
    (failed,) = (finding for finding in findings if finding.status == "failed")
    assert (failed.check, failed.message) == ("image", message)
    after = findings[findings.index(failed) + 1 :]
    assert {finding.status for finding in after} == {"skipped"}
