"""The notebooks run from their first cell to their last, by the one import; none holds results."""

import re

import pytest

FOLDER = "examples/notebooks"
NAMES = ("technician_day", "correcting_a_model", "a_fleet")
MAY_IMPORT = {"ema_phm", "numpy", "pathlib"}
MACHINE = re.compile(r"/(home|root|work|tmp|Users)/|[A-Z]:\\\\")


@pytest.fixture(params=NAMES)
def path(request, repository):
    return repository / FOLDER / f"{request.param}.ipynb"


def test_all_are_here(repository):
    assert {p.stem for p in (repository / FOLDER).glob("*")} == set(NAMES)


def test_stored_without_results_and_by_one_import(path):
    nbformat = pytest.importorskip("nbformat")
    text = path.read_text(encoding="utf-8")
    assert not MACHINE.search(text)
    book = nbformat.reads(text, as_version=4)
    nbformat.validate(book)
    code = [cell for cell in book.cells if cell.cell_type == "code"]
    assert all(cell.outputs == [] and cell.execution_count is None for cell in code)
    source = "\n".join(cell.source for cell in code)
    named = re.findall(r"^\s*(?:from|import) (\w+)", source, re.MULTILINE)
    assert set(named) <= MAY_IMPORT
    assert source.startswith("import ema_phm as ema") or "\nimport ema_phm as ema" in source


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_it_runs(path, repository, tmp_path, monkeypatch):
    nbformat, nbclient = pytest.importorskip("nbformat"), pytest.importorskip("nbclient")
    pytest.importorskip("ipykernel")
    (tmp_path / "bags").symlink_to(repository / "bags")
    for name in ("XDG_CACHE_HOME", "IPYTHONDIR", "JUPYTER_RUNTIME_DIR", "MPLCONFIGDIR"):
        monkeypatch.setenv(name, str(tmp_path / name.lower()))
    monkeypatch.delenv("MPLBACKEND", raising=False)  # figures are shown
    book = nbformat.read(path, as_version=4)
    nbclient.NotebookClient(
        book, timeout=600, resources={"metadata": {"path": str(tmp_path)}}).execute()
    shown = [kind for cell in book.cells if cell.cell_type == "code" for out in cell.outputs
             for kind in out.get("data", {})]
    assert "text/html" in shown
    assert "image/png" in shown or path.stem == "correcting_a_model"
    told = [out for cell in book.cells if cell.cell_type == "code" for out in cell.outputs
            if out.output_type == "stream" and out.name == "stderr"]
    assert told == []
