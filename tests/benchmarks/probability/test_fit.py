"""From stored matches to models and report, on synthetic scenes."""

import dataclasses
import json

import dense_scene
import numpy as np
import pytest
from boxes import box_picture
from command_line import assert_refused, run
from results import GOOD_EVIDENCE
from scenes import pinhole, two_view_scene

from dgc_pose.benchmarks.posed_pairs import PosedPair
from dgc_pose.benchmarks.probability.fitting import fit_lines, fit_model, fit_same_place
from dgc_pose.benchmarks.probability.judging import judged
from dgc_pose.benchmarks.probability.planned import Part, PlanEntry, PlannedPair
from dgc_pose.benchmarks.probability.records import PoseRecord, Record, collect, records
from dgc_pose.benchmarks.probability.report import fit_all, report_text
from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.lines import LOG_FOCALS, focal_scores
from dgc_pose.errors import InputError
from dgc_pose.estimation import EstimationOptions
from dgc_pose.estimation.probability import FEATURES, parse_models, shipped_text
from dgc_pose.images.image import Image
from dgc_pose.matching import Matcher, MatchResult

OPTIONS = EstimationOptions(runs=2, iterations=100)
BOTH = ("report", "scenes")  # rows of a matcher in the table by matcher
PARTS: tuple[Part, ...] = ("fit", "report")
FOCAL_ERROR = {"slope": 0.0, "intercept": 0.0}
SAME_PLACE = {"slope": 0.0, "intercept": 30.0}


class _Scenes(Matcher):
    """The matches of a two-view scene of its own for each pair, in turn, on images that show
    nothing: so they are not filtered."""

    name = "scenes"

    def __init__(self) -> None:
        self.matches = two_view_scene("random", count=60).matches

    def match(self, image1: Image, image2: Image) -> MatchResult:
        return MatchResult(self.matches, None)


def _pairs(matcher: _Scenes, part: Part, count: int) -> tuple[PlanEntry, list[PlannedPair]]:
    """Every second pair has a scene, some of them a plane; the matches of the others are random."""
    source = PlanEntry(part, part, "list", withheld=0)

    def make(number: int) -> PosedPair:
        kind = ("random", "general", "random", "planar")[number % 4]
        scene = two_view_scene(kind, seed=number, count=150, outliers=0.2 + 0.004 * number)
        matcher.matches = dataclasses.replace(scene.matches, key_points=True)
        t = scene.t if kind != "random" else np.array([0.0, 0, 1])
        blank = [Image(np.zeros((*camera.size[::-1], 3), np.uint8)) for camera in scene.cameras]
        return PosedPair(*blank, *scene.cameras, scene.R, t)

    own = [PlannedPair(source, k, f"{part} {k % 5}", lambda k=k: make(k)) for k in range(count)]
    return source, own


def _stored(pieces: list[dict]) -> list[dict]:
    """As they come back from the disk."""
    return json.loads(json.dumps(pieces))


@pytest.mark.slow
def test_models_and_report_come_of_records_alone():
    matcher = _Scenes()
    sources = []
    pieces = []
    for part in PARTS:
        source, pairs = _pairs(matcher, part, 88 if part == "fit" else 24)
        pieces += [collect(pair, {"a": matcher}, OPTIONS) for pair in pairs]
        sources.append(source)
    for piece in pieces:
        piece["records"]["b"] = piece["records"]["a"]
    settings = {"engines": {}, "others": {"a": {}, "b": {}}}
    text, report, figure = fit_all(_stored(pieces), settings, sources)
    models = parse_models(text).by_kind
    assert models["key_points"].tested == ("a", "b")
    shipped = json.loads(shipped_text())
    del shipped["models"]["key_points"]
    own = json.loads(text)
    del own["models"]["key_points"]
    assert own == shipped  # without a network's records, its models stay
    weights = models["key_points"].weights
    assert weights and all(FEATURES[name].sign * w >= 0 for name, w in weights.items())
    assert "calibration error" in report and "key points, by matcher" in report
    assert "lines of the images: {'sharpness': " in report
    by_matcher = [line.split()[:3] for line in report.splitlines() if line[:2] in ("a ", "b ")]
    rows = [[name, out, part] for name, out in ("a-", "b-", "aa", "bb") for part in BOTH]
    assert by_matcher == rows and report.count("\nall  ") == 2 * len(BOTH) + 1
    assert len(figure.axes[0].lines) > 1
    known = [row for row in records(pieces, "a", sources) if row.evidence is not None]
    likely = [models["key_points"].probability(row.evidence) >= 0.5 for row in known]
    assert np.mean(np.equal(likely, [row.best.right for row in known])) > 0.95


def test_records_have_the_pose_its_evidence_and_the_lines(tmp_path):
    images = [Image(box_picture(focal)) for focal in (0.8, 1.2)]
    cameras = [pinhole(focal * 960, (960, 720)) for focal in (0.8, 1.2)]
    scene = two_view_scene("general", count=40)
    matcher = _Scenes()
    source = PlanEntry("boxes", "fit", "list")
    matcher.matches = scene.matches
    made = PosedPair(*images, *cameras, scene.R, scene.t)
    pair = PlannedPair(source, 3, "place", lambda: made)
    (piece,) = _stored([collect(pair, {"sift": matcher}, OPTIONS)])
    exact, auto = records([piece], "sift", [source])
    assert (exact.entry, exact.scene, exact.cameras) == (source, "place", "exact")
    assert auto.cameras == "auto" and auto.evidence.rotation.shape == (3, 3)
    for image, (_, scores, segments) in zip(images, piece["focals"], strict=True):
        expected, count = focal_scores(image)
        np.testing.assert_allclose(scores, expected)
        assert segments == count > 50
    assert fit_lines([piece])["gain"] > 0.5


def test_a_map_is_evidence():
    matcher = dense_scene.MapMatcher(dense_scene.true_map())
    camera = Camera(dense_scene.K, dense_scene.SIZE)
    images = [Image(pixels) for pixels in dense_scene.pictures()]
    source = PlanEntry("one", "report", "list", withheld=0)
    posed = PosedPair(*images, camera, camera, dense_scene.R, dense_scene.T)
    pair = PlannedPair(source, 0, "one", lambda: posed)
    piece = collect(pair, {"net": matcher}, OPTIONS)
    assert piece["focals"] == []
    (found,) = records(_stored([piece]), "net", [source])
    assert found.best.right and found.evidence is not None
    assert found.evidence.map_agreement > 0.9 > 0.5 > found.evidence.map_chance


def test_what_cannot_be_fitted_is_refused(tmp_path):
    data = [one for one in _records(300, 0, "fit") if one.any_right]
    with pytest.raises(InputError, match="0 wrong poses of 5 scenes to fit on"):
        fit_model(data, "network")
    words = ("fit-probability", "--data", tmp_path, "--out", tmp_path)
    assert_refused(run(*words, "--collected"), "records.jsonl")
    assert_refused(run(*words, "--methods", "sift"), "no such image; it is named in the pair list")


CHOICE = 1.5  # log-odds for a unit of the likelihood


def _records(count: int, seed: int, part: Part) -> list[Record]:
    """Poses whose chance to be right is a known function of three numbers."""
    rng = np.random.default_rng(seed)
    found = []
    entry = PlanEntry("s", part, "list")
    for k in range(count):
        ratio = rng.random()
        cells = rng.integers(5, 120)
        agreement = rng.random()
        odds = 6 * (ratio - 0.5) + 2 * np.log(cells / 25) + 2 * (agreement - 0.5)
        right = rng.random() < 1 / (1 + np.exp(-odds))
        own = 0.3 * np.exp(rng.normal())
        # The jackknife's error is half of what it should be.
        error = 0.6 / 1.645 * own / 0.3 * abs(rng.normal()) if right else 60.0
        evidence = dataclasses.replace(
            GOOD_EVIDENCE,
            inlier_ratio=ratio,
            occupied_cells=int(cells),
            map_agreement=agreement,
            raw_rotation_90_deg=own,
            raw_translation_90_deg=own,
        )
        # A second pose beside every other: the likelihood tells which is right, more or less.
        poses = [PoseRecord(0.0, 0.0, error, error)]
        if k % 2:
            apart = 3 * rng.random()
            poses.append(PoseRecord(-apart, 0.0, 60.0, 60.0))
            if rng.random() > 1 / (1 + np.exp(-CHOICE * apart)):
                poses = [PoseRecord(0.0, 0.0, 60.0, 60.0), PoseRecord(-apart, 0.0, error, error)]
        found.append(Record(entry, f"{part} {k % 5}", evidence, tuple(poses)))
    return found


def test_the_fit_finds_a_known_probability_and_a_known_error():
    models = {"network": fit_model(_records(1000, 0, "fit"), "network")}
    data = {"engine": {}, "focal_error": FOCAL_ERROR, "same_place": SAME_PLACE, "models": models}
    fitted = parse_models(json.dumps(data))
    model = fitted.by_kind["network"]
    fresh = [judged(one, model) for one in _records(1500, 2, "report")]
    probability = np.array([one.probability for one in fresh])
    right = np.array([one.right for one in fresh])
    for low, high in ((0.0, 0.3), (0.3, 0.7), (0.7, 1.01)):
        own = (probability >= low) & (probability < high)
        assert right[own].mean() == pytest.approx(probability[own].mean(), abs=0.08)
    errors = [one.record.best.rotation_error_deg for one in fresh]
    within = [e <= o.rotation_90_deg for e, o in zip(errors, fresh, strict=True) if o.right]
    assert 0.85 < np.mean(within) < 0.95
    assert model.choice["likelihood"] == pytest.approx(CHOICE, rel=0.25)
    assert any(one.ambiguous for one in fresh)
    claimed = [one for one in fresh if one.by_probability and len(one.record.poses) > 1]
    mean = np.mean([one.probability for one in claimed])
    assert np.mean([one.right for one in claimed]) == pytest.approx(mean, abs=0.08)
    assert "calibration error" in report_text(fresh)


def test_the_place_is_logistic_in_its_surroundings_and_certain_of_too_few():
    rng = np.random.default_rng(0)
    around = rng.uniform(0, 1, 20_000)
    right = rng.random(20_000) < 1 / (1 + np.exp(2 - 7 * around))
    assert fit_same_place(around, right) == pytest.approx(
        {"slope": 7.0, "intercept": -2.0}, rel=0.05
    )
    assert fit_same_place(around, ~right)["slope"] == 0  # never against what is alike
    assert fit_same_place(around[:9], right[:9]) == {"slope": 0.0, "intercept": 30.0}


def test_the_fit_of_the_lines_finds_how_sure_they_are():
    """With focal lengths that are drawn from the posterior that such numbers have."""
    rng = np.random.default_rng(0)
    sharpness = 2.5
    chance = 0.05
    usual = np.exp(-(((LOG_FOCALS - np.log(0.9)) / 0.35) ** 2) / 2) / 0.35
    tail = np.exp(-(((LOG_FOCALS - np.log(2.0)) / 0.7) ** 2) / 2) / 0.7
    prior = 0.85 * usual + 0.15 * tail
    pieces = []
    for _ in range(1000):
        focals = []
        for _ in range(2):
            peak = rng.normal(0, 0.5)
            count = int(rng.integers(20, 160))
            own = 0.3 + 0.6 * np.exp(-(((LOG_FOCALS - peak) / 0.3) ** 2))
            odds = np.exp(sharpness * np.sqrt(count) * (own - own.max()))
            odds = ((1 - chance) * odds / odds.mean() + chance) * prior
            true = rng.choice(LOG_FOCALS, p=odds / odds.sum())
            focals.append((float(true), own.tolist(), count))
        pieces.append({"scene": "s", "focals": focals})
    found = fit_lines(pieces)
    assert (found["sharpness"], found["chance"]) == (sharpness, chance)
    assert found["gain"] > 0.5
