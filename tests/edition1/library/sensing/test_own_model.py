"""Models of a user's own: any dtype and form that torch has, and messages where they do not fit."""

from __future__ import annotations

import re
import shutil
import warnings
from pathlib import Path

import pytest
import torch
from torch import nn

from edition1.errors import InputError
from edition1.estimation.base import track
from edition1.estimation.levenberg_marquardt import jacobian
from edition1.robot_file.load import load_robot
from edition1.sensing.magnetic import MagneticSensing
from edition1.sensing.network import Dropout, PerSensor, paper_network
from edition1.sensing.own_model import OwnModel
from edition1.sensing.weights import load_paper_network, save_weights
from edition1_companion.twins.trajectories import lemniscate
from edition1_live.follow.robot_estimator import robot_estimator

DATA = Path(__file__).parents[4] / "data"
ROBOTS = DATA / "robots"
TRAINED = min((DATA / "networks").glob("pcc_nb1_*.safetensors"))
ONE = load_robot(ROBOTS / "one_segment.toml")
assert ONE.moments is not None
MOMENT = ONE.moments[:1]
ONE_TEXT = (ROBOTS / "one_segment.toml").read_text()


def trained(dtype: torch.dtype = torch.float32) -> nn.Sequential:
    """Return a network with batch norms, trained on angles."""
    return load_paper_network(TRAINED).to(dtype)


class ArcCosine(nn.Module):
    """The dipole field by angles that the model takes itself, with a weight of a dtype."""

    def __init__(self, dtype: torch.dtype = torch.float64) -> None:
        super().__init__()
        self.moment = nn.Parameter(MOMENT.to(dtype))

    def forward(self, cosines: torch.Tensor) -> torch.Tensor:
        d = cosines[..., 1]
        alpha, beta, theta = torch.acos(cosines[..., 2:]).unbind(-1)
        return self.moment * (3 * theta.cos() * beta.cos() - alpha.cos()) / d**3


def dipole(cosines):
    d, alpha, beta, theta = cosines[..., 1:].unbind(-1)
    return MOMENT.to(cosines) * (3 * theta * beta - alpha) / d**3


FORMS = {
    "module": lambda m: m,
    "script": torch.jit.script,
    "trace": lambda m: torch.jit.trace(m, torch.rand(6, 5, dtype=next(m.parameters()).dtype)),
    "freeze": lambda m: torch.jit.freeze(torch.jit.script(m)),
    "callable": lambda m: lambda rows: m(rows),
}


def quiet(form: str, module: nn.Module):
    """Return a form of a module; torch calls most of them deprecated."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        return FORMS[form](module)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("form", FORMS)
def test_a_network_in_every_form_and_dtype_reads_as_it_does_by_itself(form, dtype):
    plain = nn.Sequential(*[layer for layer in trained(dtype) if not isinstance(layer, Dropout)])
    plain.eval()
    sensing = ONE.sensing(quiet(form, plain), inputs="angles")
    reference = ONE.sensing(trained(torch.float64), inputs="angles")
    q = lemniscate(1, steps=5)
    u, J = jacobian(sensing, q)
    u_64, J_64 = jacobian(reference, q)
    assert u.dtype == J.dtype == torch.float64
    torch.testing.assert_close(u, u_64, rtol=0, atol=2e-5)
    torch.testing.assert_close(J, J_64, rtol=2e-3, atol=1e-2 * float(J_64.abs().max()) * 1e-2)
    assert sensing(q[0]).shape == (3,)
    torch.testing.assert_close(sensing(q[2]), u[2])


def test_the_jacobian_is_that_of_differences():
    sensing = ONE.sensing(trained(), inputs="angles")
    q = lemniscate(1, steps=4)[1]
    _, J = jacobian(sensing, q)
    h = 1e-7
    steps = torch.stack(
        [(sensing(q + h * e) - sensing(q - h * e)) / (2 * h) for e in torch.eye(3).double()], -1
    )
    torch.testing.assert_close(J, steps, rtol=1e-4, atol=1e-3)


def test_a_batch_norm_is_evaluated_and_the_module_of_the_user_stays_as_it_was():
    mine = trained().train()
    before = {name: value.clone() for name, value in mine.state_dict().items()}
    sensing = ONE.sensing(mine, inputs="angles")
    q = lemniscate(1, steps=6)
    torch.testing.assert_close(sensing(q)[3], sensing(q[3]))  # a row does not depend on its batch
    assert mine.training
    assert next(mine.parameters()).requires_grad
    assert all(torch.equal(value, before[name]) for name, value in mine.state_dict().items())


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_the_straight_pose_has_finite_derivatives_though_the_model_takes_arc_cosines(dtype):
    for model in (
        ArcCosine(dtype),
        quiet("script", ArcCosine(dtype)),
        lambda c: ArcCosine(dtype)(c.to(dtype)),
    ):
        u, J = jacobian(ONE.sensing(model), ONE.start)
        exact, exact_J = jacobian(ONE.sensing(dipole), ONE.start)
        assert torch.isfinite(J).all()
        torch.testing.assert_close(u, exact, rtol=1e-5, atol=0)
        # the derivatives by an angle at its kink are zero, as those of angles of the project
        torch.testing.assert_close(J[:, 2], exact_J[:, 2], rtol=1e-2, atol=0)


@pytest.mark.parametrize("name", ["levenberg_marquardt", "kalman", "gradient_descent", "particle_filter"])
def test_every_estimator_follows_with_a_network_in_float32(name):
    estimator = robot_estimator(ONE, name, model=trained(), inputs="angles")
    q = lemniscate(1, steps=400)[:12]
    found = track(estimator.method, ONE.sensing()(q), estimator.start).q
    assert found.dtype == torch.float64
    assert torch.isfinite(found).all()
    if name in ("levenberg_marquardt", "kalman"):
        assert float((found - q).abs().max()) < 3e-3  # the network's own error


def three() -> tuple:
    robot = load_robot(ROBOTS / "three_segments.toml")
    return robot, 1 + 4 * len(robot.robot.magnets), len(robot.robot.sensors), robot.robot.sensors.segment


def test_one_network_per_sensor_and_one_per_segment():
    robot, width, n, segment = three()
    networks = [paper_network(width, torch.Generator().manual_seed(k)).eval() for k in range(n)]
    alone = torch.stack([robot.sensing(one, inputs="angles")(robot.start) for one in networks])
    per_sensor = robot.sensing(networks, inputs="angles")(robot.start)
    torch.testing.assert_close(per_sensor, alone[range(n), range(n)])
    per_segment = robot.sensing(networks[:3], inputs="angles")(robot.start)
    torch.testing.assert_close(per_segment, alone[segment, range(n)])
    same = robot.sensing(nn.ModuleList(networks), inputs="angles")(robot.start)
    torch.testing.assert_close(same, per_sensor)
    whole = PerSensor(networks, range(n))  # a module on the relations of all sensors at once
    torch.testing.assert_close(robot.sensing(whole, inputs="angles")(robot.start), per_sensor)
    with pytest.raises(
        InputError, match=rf"must be one, or 3 \(one per segment\), or {n} \(one per sensor\)"
    ):
        robot.sensing(networks[:2])


@pytest.mark.parametrize(
    ("model", "message"),
    [
        (paper_network(9, torch.Generator()), r"rows of 5 relations, .* for \(6, 5\) of float64: .*9"),
        (nn.Linear(5, 2), r"a reading each; instead received for \(6, 5\) of float64: shape \(6, 2\)"),
        (lambda xi: "u", r"instead received for \(2, 3, 5\) of float64: str"),
        (lambda xi: 1 / 0, "division by zero"),
        (lambda xi: xi[..., 0] * torch.nan, "finite readings where estimators start; instead received"),
        (lambda xi: xi[..., 0].detach(), "readings change with the relations"),
        (
            lambda xi: (xi[..., 2].abs() - 1 + 1e-8).clamp_min(0).sqrt() * 0 + (xi[..., 0] * 0).sqrt(),
            "finite deriv",
        ),
        ("none.pt", "none.pt, which is not there"),
        ([], "must be one, or 1 .one per segment., or 3 .one per sensor.; instead received 0 of them"),
    ],
)
def test_models_that_do_not_fit_are_refused_with_dtype_and_shape(model, message):
    with pytest.raises(InputError, match=message):
        ONE.sensing(model)


def test_inputs_are_angles_or_cosines():
    with pytest.raises(
        InputError, match="inputs of sensing must be 'angles' or 'cosines'; instead received 'deg'"
    ):
        ONE.sensing(dipole, inputs="deg")
    sensing = ONE.sensing(dipole)
    assert isinstance(sensing, MagneticSensing)
    assert isinstance(sensing.model, OwnModel)


def with_networks(folder: Path, names: str, more: str = "") -> Path:
    path = folder / "robot.toml"
    path.write_text(f"{ONE_TEXT}\n[model]\nnetworks = [{names}]\n{more}")
    return path


UNKNOWN_ERROR = "robot.toml: no error of the networks is known; what estimates state holds the noise alone."


def test_reading_a_robot_file_runs_no_program(tmp_path):
    quiet("trace", trained()).save(tmp_path / "net.pt")
    with pytest.raises(
        InputError, match=r"line \d+, \[model\], must be safetensors files: TorchScript is a program"
    ):
        load_robot(with_networks(tmp_path, '"net.pt"'))
    save_weights(trained(), tmp_path.parent / "a.safetensors", {"recipe": "paper"})
    with pytest.raises(InputError, match="must be files in the folder of the robot file"):
        load_robot(with_networks(tmp_path, '"../a.safetensors"'))


def test_networks_of_a_robot_file_are_refused_when_it_is_read(tmp_path):
    (tmp_path / "alone.safetensors").write_bytes(TRAINED.read_bytes())
    with pytest.raises(
        InputError, match=r"robot.toml, line \d+, \[model\]: .*their manifest alone.json beside them"
    ):
        load_robot(with_networks(tmp_path, '"alone.safetensors"'))
    save_weights(trained(), tmp_path / "a.safetensors", {"recipe": "paper"})
    with pytest.raises(
        InputError, match="inputs of robot.toml, line .* must be 'angles', which networks of the"
    ):
        load_robot(with_networks(tmp_path, '"a.safetensors"', 'inputs = "cosines"\n'))


def test_a_robot_with_networks_is_not_warned_of_ranges_in_its_unit(tmp_path):
    save_weights(trained(), tmp_path / "a.safetensors", {"recipe": "paper"})
    text = re.sub("noise_mt = .*", "noise_mv = 0.24", ONE_TEXT.replace('unit = "mT"', 'unit = "mV"'))
    path = tmp_path / "robot.toml"
    path.write_text(f'{text}\n[model]\nnetworks = ["a.safetensors"]\n')
    assert load_robot(path).notes == (UNKNOWN_ERROR,)


def test_the_page_runs(tmp_path, monkeypatch):
    page = (DATA.parent / "book" / "own_robot.md").read_text()
    section = page[page.index("(own-model)=") :]
    shutil.copytree(ROBOTS, tmp_path / "data" / "robots")
    monkeypatch.chdir(tmp_path)
    (block,) = re.findall(r"```python\n(.*?)```", section, re.S)
    exec(block, {})
