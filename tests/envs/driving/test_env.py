"""Properties of driving alone: highway-env's vehicle, its drivers, recorded tracks."""

from functools import partial

import gymnasium
import numpy as np
import pytest
from highway_env.road.road import Road
from highway_env.vehicle.behavior import IDMVehicle
from highway_env.vehicle.kinematics import Vehicle

from agents import InferGamma, make_ego
from foresight_env.envs import driving_v0
from foresight_env.envs.core.motion import advance
from foresight_env.envs.driving.drivers import IdmDrivers, RecordedDrivers
from foresight_env.highway.axes import flipped_controls, flipped_states
from foresight_env.highway.scenes import SCENES
from foresight_env.inverse import Prior
from foresight_env.scenarios.driving import driving_game, player_theta

SHORT = {"cars": 2, "planning_horizon": 4}
ZERO = np.zeros(2, dtype=np.float32)


@pytest.mark.parametrize(("policy", "simulation"), [(10, 10), (10, 20), (5, 15)])
def test_one_step_is_highway_envs(policy, simulation):
    """To 1e-12, for random states and controls, whatever the frequencies."""
    random = np.random.default_rng(policy + simulation)
    substeps = simulation // policy
    game = driving_game(1, 3, 1.0 / policy, substeps)
    theta = (player_theta(np.zeros((20, 4)), 10.0, np.zeros(2)),)
    for _ in range(20):
        state = np.array(
            [[*random.uniform(-50, 50, 2), random.uniform(1, 25), random.uniform(-6, 6)]]
        )
        control = np.array([[random.uniform(-5, 5), random.uniform(-0.6, 0.6)]])
        vehicle = Vehicle(None, *_placed(state))
        acceleration, steering = flipped_controls(control)[0]
        for _ in range(substeps):
            vehicle.act({"acceleration": acceleration, "steering": steering})
            vehicle.step(1.0 / simulation)
        after, _ = advance(game, state, control, theta)
        theirs = np.array([[*vehicle.position, vehicle.speed, vehicle.heading]])
        np.testing.assert_allclose(after, flipped_states(theirs), rtol=0, atol=1e-12)


def _placed(state):
    x, y, speed, heading = flipped_states(state)[0]
    return np.array([x, y]), heading, speed


@pytest.mark.parametrize("scene", SCENES)
def test_idm_cars_drive_as_highway_envs_road_drives_them(scene):
    """All cars on highway-env's own road, `Road.act` and `Road.step`, against the environment."""
    everybody = driving_v0.parallel_env(
        scene=scene, behaviour="idm", controlled=(0,), policy_frequency=10, simulation_frequency=10
    )
    _, infos = everybody.reset(seed=2)
    info = infos["car_0"]
    episode_parameters = everybody._episode.episode_parameters
    drivers = IdmDrivers(SCENES[scene], everybody_setting(everybody))
    drivers.reset(episode_parameters)
    road: Road = drivers._vehicles[0].road
    states = info["state"]
    for _ in range(15):
        for vehicle in road.vehicles:
            vehicle.timer += 0.1  # highway-env counts after deciding; we count before
            vehicle.on_state_update()
        road.act()
        controls = flipped_controls(
            np.array([[v.action["acceleration"], v.action["steering"]] for v in road.vehicles])
        )
        clipped = np.clip(controls, [-5.0, -0.6], [5.0, 0.6])
        for vehicle, control in zip(road.vehicles, flipped_controls(clipped), strict=True):
            vehicle.action = {"acceleration": control[0], "steering": control[1]}
            Vehicle.step(vehicle, 0.1)
        theirs = flipped_states(
            np.array([[*v.position, v.speed, v.heading] for v in road.vehicles])
        )
        action = clipped[0].astype(np.float32)
        _, _, _, _, infos = everybody.step({"car_0": action})
        states = infos["car_0"]["state"]
        np.testing.assert_allclose(states, theirs, atol=1e-5)  # the ego's action is float32


def everybody_setting(env):
    from foresight_env.envs.core.behaviours import BehaviourSetting

    return BehaviourSetting(env._world.game, 4, 10)


def test_nothing_is_written_to_highway_envs_classes():
    """IntersectionEnv changes IDM's parameters for the whole process; these environments do not."""
    kept = [{k: v for k, v in vars(c).items()} for c in (IDMVehicle, Vehicle)]
    for scene in SCENES:
        env = driving_v0.parallel_env(scene=scene, behaviour="idm", render_mode="rgb_array")
        env.reset(seed=0)
        env.step({"car_0": ZERO})
        env.render()
        env.close()
    assert [{k: v for k, v in vars(c).items()} for c in (IDMVehicle, Vehicle)] == kept


def test_recorded_tracks_are_followed():
    """The track of an earlier drive, positions alone, is driven again to a few centimetres."""
    random = np.random.default_rng(0)
    env = driving_v0.parallel_env(cars=2, controlled="all")
    _, infos = env.reset(seed=4)
    track = [infos["car_0"]["state"]]
    for t in range(40):
        gentle = np.array([np.sin(0.3 * t), 0.02 * np.cos(0.2 * t)]) + 0.01 * random.normal(size=2)
        actions = {a: gentle.astype(np.float32) for a in env.agents}
        track.append(env.step(actions)[4]["car_0"]["state"])
    places = np.stack(track)[:, :, :2].copy()
    places[:, 0] = np.nan  # the user drives car 0
    again = driving_v0.parallel_env(cars=2, behaviour=lambda setting: RecordedDrivers(places, 0.1))
    again.reset(seed=4)
    for t in range(38):
        infos = again.step({"car_0": ZERO})[4]
        np.testing.assert_allclose(infos["car_0"]["state"][1, :2], places[t + 1, 1], atol=0.05)
    # Where the track ends, the car brakes.
    for _ in range(5):
        infos = again.step({"car_0": ZERO})[4]
    assert infos["car_0"]["applied_action"] is not None
    assert infos["car_0"]["controls"][1, 0] == pytest.approx(-5.0)


def test_every_car_its_own_driver():
    """Each acts as it would if all were driven so (here for one step)."""
    controls, status, stages = {}, {}, {}
    same = ("receding", "receding")
    for behaviour in (("receding", "idm"), ("idm", "receding"), "idm", "receding", same):
        env = driving_v0.parallel_env(behaviour=behaviour, **SHORT)
        _, infos = env.reset(seed=1)
        assert infos["car_0"]["solver_status"] == -1
        stages[behaviour] = infos["car_0"]["plan_stages"]
        infos = env.step({"car_0": ZERO})[4]
        controls[behaviour] = infos["car_0"]["controls"][1]
        status[behaviour] = infos["car_0"]["solver_status"]
    np.testing.assert_array_equal(controls["receding", "idm"], controls["idm"])
    np.testing.assert_array_equal(controls["idm", "receding"], controls["receding"])
    assert not np.array_equal(controls["idm"], controls["receding"])
    assert (status["idm"], status["receding"], status["idm", "receding"]) == (-1, 0, 0)
    # Only where all play one game there is a plan of all.
    assert list(stages.values()) == [0, 0, 0, 4, 4]


@pytest.mark.parametrize("ego", ["oracle", "constant-velocity"])
def test_egos_drive(ego):
    """They turn left before a car that plays the game, to the goal and without a collision."""
    env = driving_v0.parallel_env(cars=2, noise_std=0.05, max_steps=70)
    policy = make_ego(ego)
    observations, infos = env.reset(seed=3)
    memory = policy.init(env.scene, "car_0")
    while env.agents:
        memory = policy.update(memory, observations["car_0"], infos["car_0"])
        decision, memory = policy.act(memory)
        observations, _, _, _, infos = env.step({"car_0": decision.action})
    assert infos["car_0"]["is_success"]


def test_what_the_ego_infer_gamma_assumes_of_others():
    """From the first observation on: the way along the road, the speed it has, its own weights."""
    env = driving_v0.parallel_env(noise_std=0.0, **SHORT)
    policy = InferGamma()
    observations, infos = env.reset(seed=3)
    memory = policy.init(env.scene, "car_0")
    memory = policy.update(memory, observations["car_0"], infos["car_0"])
    own, other = memory.state.theta
    truth = infos["car_0"]
    state = truth["state"][1]
    assert other["target_speed"] == pytest.approx(state[2], abs=1e-4)
    assert other["collision_weight"] == own["collision_weight"]
    np.testing.assert_array_equal(own["path"], truth["theta"]["path"][0])
    # The oncoming car drives straight on, and so it is thought to.
    for ahead in (5.0, 20.0, 40.0):
        place = state[:2] + np.array([0.0, -ahead])
        assert np.linalg.norm(other["path"][:, :2] - place, axis=1).min() < 1.1
    assert memory.estimator.game.horizon == policy.window - 1 + 2  # three fifths of four stages
    assert [f.theta for f in memory.estimator.free] == [(), ("target_speed",)]
    assert memory.estimator.prior.theta_deviation == env.scene.opponent_prior.deviation
    surer = (("target_speed", 0.5),)
    stated = InferGamma(prior=Prior(theta_deviation=surer)).init(env.scene, "car_0")
    assert stated.estimator.prior.theta_deviation == surer


def test_leaving_the_road_ends_the_episode():
    env = driving_v0.parallel_env(behaviour="idm", **SHORT)
    env.reset(seed=0)
    infos = {}
    while env.agents:
        infos = env.step({"car_0": np.array([2.0, -0.6], dtype=np.float32)})[4]
    assert infos["car_0"]["off_road"]
    assert not infos["car_0"]["is_success"]


def test_several_scenes_live_side_by_side():
    """Also in separate processes, as vector environments have them."""
    make = partial(gymnasium.make, "foresight/Driving-v0", behaviour="idm", **SHORT)
    alone = [make(scene=s) for s in SCENES]
    first = [env.reset(seed=5)[0] for env in alone]
    with_others = gymnasium.vector.SyncVectorEnv([partial(make, scene=s) for s in SCENES])
    seen, _ = with_others.reset(seed=[5] * len(SCENES))
    np.testing.assert_array_equal(seen, np.stack(first))


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ({"scene": "moon"}, "scene: is 'moon'"),
        ({"cars": 1}, "cars: is 1; expected an integer from 2 to 6"),
        ({"simulation_frequency": 15}, "simulation_frequency: is 15; expected a multiple"),
        ({"behaviour": "wild"}, "behaviour: is 'wild'"),
        ({"behaviour": ("idm",)}, "behaviour: has 1 entries; expected one per car, 4"),
        ({"behaviour": ("idm",) * 3 + ("x",)}, r"behaviour\[3\]: is 'x'"),
        ({"ranges": {}}, "ranges: is {}"),
        ({"max_steps": 0}, "max_steps: is 0"),
    ],
)
def test_wrong_arguments(arguments, told):
    with pytest.raises(ValueError, match=told):
        driving_v0.parallel_env(**arguments)


def test_processes_of_their_own_change_nothing():
    """Started by `spawn`: a forked process of one that has used JAX waits for ever."""
    chosen = {"num_envs": 2, "scene": "merge", "behaviour": "idm", **SHORT}

    def walked(mode, settings):
        envs = gymnasium.make_vec(
            "foresight/Driving-v0", vectorization_mode=mode, vector_kwargs=settings, **chosen
        )
        envs.reset(seed=3)
        steps = [envs.step(np.zeros(envs.action_space.shape, np.float32))[:4] for _ in range(3)]
        envs.close()
        return steps

    together = walked("sync", {})
    apart = walked("async", {"context": "spawn"})
    for one, other in zip(together, apart, strict=True):
        for a, b in zip(one, other, strict=True):
            np.testing.assert_array_equal(a, b)
