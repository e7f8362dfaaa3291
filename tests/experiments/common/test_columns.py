"""Rows tell the version of the code that made them."""

import regtorch
from experiments.common.columns import code_version


def test_rows_of_changed_code_are_of_another_version(tmp_path):
    versions = []
    for text in ("one = 1", "one = 2", "one = 2"):
        package = tmp_path / str(len(versions))
        (package / "inner").mkdir(parents=True)
        (package / "inner" / "code.py").write_text(text)
        versions.append(code_version(package))
    assert versions[1] == versions[2] != versions[0]
    assert all(version.startswith(f"{regtorch.__version__}+") for version in versions)
