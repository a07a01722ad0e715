import filecmp
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from ema_cli.main import run as ema
from ema_record.bag.read import read_bag
from ema_record.errors import OutputError, UsageError
from ema_record.profile import load_profile
from ema_sim.campaign.plan import load_plan
from ema_sim.campaign.reductions import summary
from ema_sim.campaign.run import run_campaign
from ema_sim.campaign.runs import prepare
from ema_sim.campaign.store import load_campaign
from ema_sim.simulate import simulate

PLAN = """
profile: step
seed: 7
runs: {runs}
parameters:
  actuator.motor.phase_resistance: {{normal: [1.0, 0.03], relative: true}}
  turn_short.fraction: {{log_uniform: [0.002, 0.2]}}
  turn_short.phase: {{choice: [a, b, c]}}
"""


@pytest.fixture
def plan(tmp_path):
    def write(runs=60, more=""):
        path = tmp_path / "plan.yaml"
        path.write_text(PLAN.format(runs=runs) + more)
        return path

    return write


def files_of(folder):
    return sorted(str(p.relative_to(folder)) for p in Path(folder).rglob("*") if p.is_file())


def assert_same_bytes(one, other):
    assert files_of(one) == files_of(other)
    _, different, errors = filecmp.cmpfiles(one, other, files_of(one), shallow=False)
    assert different == errors == []


def samples_sum(record):
    return {"sum": record.samples.sum(axis=0)}


@pytest.fixture
def cluster():
    """A real scheduler and two workers, as processes of their own."""
    environment = {
        **os.environ, "DASK_DISTRIBUTED__WORKER__DAEMON": "False", "PYTHONWARNINGS": "ignore",
        "PYTHONPATH": os.pathsep.join([str(Path(__file__).parents[2]), *sys.path]),
    }
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "env": environment}
    address = f"tcp://127.0.0.1:{30000 + os.getpid() % 20000}"
    processes = [subprocess.Popen(
        [sys.executable, "-m", "distributed.cli.dask_scheduler", "--host", "127.0.0.1",
         "--port", address.rsplit(":", 1)[1], "--no-dashboard", "--no-show"], **quiet,
    )]
    processes += [subprocess.Popen(
        [sys.executable, "-m", "distributed.cli.dask_worker", address, "--no-dashboard",
         "--nthreads", "1", "--no-nanny", "--death-timeout", "30"], **quiet,
    ) for _ in range(2)]
    yield address
    for process in reversed(processes):
        process.terminate()
    for process in processes:
        try:
            process.wait(10)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


@pytest.mark.slow
def test_results_do_not_depend_on_workers(plan, tmp_path):
    one = run_campaign(plan(), jobs=1, out=tmp_path / "one")
    run_campaign(plan(), jobs=2, out=tmp_path / "two")
    assert_same_bytes(tmp_path / "one", tmp_path / "two")
    loaded = load_campaign(tmp_path / "two")
    assert all(np.array_equal(one[name], loaded[name]) for name in one)
    assert not one["failed"].any()
    # The lines of a short grow with its size.
    large = one["parameters.turn_short.fraction"] > 0.05
    small = one["parameters.turn_short.fraction"] < 0.01
    line = one["results.speed_line_2"]
    assert line[large].min() > 2.0 * np.median(line[small])


@pytest.mark.slow
def test_a_cluster_gives_the_same_bytes(plan, tmp_path, cluster):
    run_campaign(plan(), jobs=1, out=tmp_path / "here")
    run_campaign(plan(), dask=cluster, out=tmp_path / "there")
    assert_same_bytes(tmp_path / "here", tmp_path / "there")


def test_a_cluster_that_is_not_there(plan, monkeypatch):
    monkeypatch.setattr("ema_sim.campaign.workers.ANSWER_TIME", 0.5)
    with pytest.raises(UsageError, match="no scheduler answers"):
        run_campaign(plan(), dask="tcp://127.0.0.1:9")


def test_one_run_alone_is_that_of_the_campaign(plan, tmp_path):
    columns = run_campaign(plan(30), jobs=1)
    run = prepare(load_plan(plan(30))).run(26)
    assert columns["seed"][26] == run.seed
    alone = summary(run.simulate())
    for name, value in alone.items():
        assert columns[f"results.{name}"][26] == value
    assert ema(["simulate", "--campaign", str(plan(30)), "--run", "26",
                "--out", str(tmp_path / "bag")]) == 0
    assert summary(read_bag(tmp_path / "bag")) == pytest.approx(alone, rel=1e-9, nan_ok=True)
    # The same with the arguments spelled out.
    direct = simulate(load_profile("step"), actuator=run.actuator, effects=run.effects,
                      seed=run.seed)
    assert direct.samples.tobytes() == run.simulate().samples.tobytes()


def test_after_an_interrupt_nothing_is_done_twice(plan, tmp_path):
    counts = []

    def stop_soon(done):
        counts.append(done)
        if done >= 50:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_campaign(plan(100), jobs=1, out=tmp_path / "out", progress=stop_soon)
    kept = {p: p.stat().st_mtime_ns for p in (tmp_path / "out/chunks").iterdir()}
    assert len(kept) == 2
    made = []
    run_campaign(plan(100), jobs=1, out=tmp_path / "out", progress=made.append)
    assert made == [50, 75, 100]
    assert all(p.stat().st_mtime_ns == when for p, when in kept.items())
    run_campaign(plan(100), jobs=1, out=tmp_path / "whole")
    assert_same_bytes(tmp_path / "out", tmp_path / "whole")


@pytest.mark.slow
def test_ctrl_c_at_the_terminal(plan, tmp_path):
    out = tmp_path / "out"
    command = [sys.executable, "-m", "ema_cli", "simulate", "--campaign", str(plan(3000)),
               "--out", str(out), "--jobs", "2"]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, start_new_session=True)
    end = time.monotonic() + 60
    while len(list(out.glob("chunks/*.npz"))) < 2 and time.monotonic() < end:
        time.sleep(0.05)
    os.killpg(process.pid, signal.SIGINT)
    _, said = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "of 3000 runs are kept" in said
    assert "Traceback" not in said
    assert len(load_campaign(out)["run"]) >= 50


def test_another_plan_in_the_same_folder_is_refused(plan, tmp_path, capsys):
    run_campaign(plan(2), jobs=1, out=tmp_path / "out")
    before = {name: (tmp_path / "out" / name).read_bytes() for name in files_of(tmp_path / "out")}
    status = ema(["simulate", "--campaign", str(plan(3)), "--out", str(tmp_path / "out")])
    assert status == 2
    assert "another plan" in capsys.readouterr().err
    with pytest.raises(OutputError, match="another reduction"):
        run_campaign(plan(2), jobs=1, out=tmp_path / "out", reduce=samples_sum)
    assert before == {n: (tmp_path / "out" / n).read_bytes() for n in files_of(tmp_path / "out")}


def test_any_function_reduces_in_python(plan):
    columns = run_campaign(plan(2), reduce=samples_sum, jobs=1)
    assert columns["results.sum"].shape == (2, 10)


def test_bags_are_kept(plan, tmp_path):
    path = plan(2, "keep: bags\n")
    with pytest.raises(UsageError, match="where to"):
        run_campaign(path)
    assert ema(["simulate", "--campaign", str(path), "--out", str(tmp_path / "out")]) == 0
    bags = sorted((tmp_path / "out/bags").iterdir())
    assert [b.name for b in bags] == ["run_000000", "run_000001"]
    made = prepare(load_plan(path)).run(1).simulate()
    assert np.array_equal(read_bag(bags[1]).samples, made.samples)
    alone = tmp_path / bags[1].name
    assert ema(["simulate", "--campaign", str(path), "--run", "1", "--out", str(alone)]) == 0
    assert files_of(alone) == ["metadata.yaml", "run_000001_0.mcap"]
    assert_same_bytes(alone, bags[1])
    shutil.rmtree(bags[1])
    assert ema(["simulate", "--campaign", str(path), "--out", str(tmp_path / "out")]) == 0
    assert_same_bytes(alone, bags[1])  # what was taken away is made again


def test_options_of_one_run_do_not_mix(plan, tmp_path, capsys):
    for options in (["--campaign", str(plan()), "--seed", "3"], ["--jobs", "2"],
                    ["--campaign", str(plan()), "--run", "60"],
                    ["--campaign", str(plan()), "--jobs", "1", "--dask", "tcp://x:1"]):
        assert ema(["simulate", *options, "--out", str(tmp_path / "out")]) == 2
    assert not (tmp_path / "out").exists()
    assert "Traceback" not in capsys.readouterr().err


def test_a_run_that_fails_does_not_stop_the_others(plan, monkeypatch):
    from ema_record.errors import SimulationError
    from ema_sim.campaign import runs as campaign_runs

    real = campaign_runs.simulate

    def fails_for_one(*arguments, **options):
        if options["serial_number"] == "SIM-0001":
            raise SimulationError("values are not finite")
        return real(*arguments, **options)

    monkeypatch.setattr(campaign_runs, "simulate", fails_for_one)
    columns = run_campaign(plan(3), jobs=1)
    assert columns["failed"].tolist() == [False, True, False]
    assert np.isnan(columns["results.speed_mean"]).tolist() == [False, True, False]
