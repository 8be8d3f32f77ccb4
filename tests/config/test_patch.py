"""A patch: what it may say, and what it does to a configuration."""

import json

import pytest
import yaml
from jsonschema import Draft202012Validator

from hilserver.commands import main
from hilserver.config.patch import ModelPatch, load_patch, patch_of
from hilserver.config.plant import PlantConfig
from hilserver.config.section import schema_text
from hilserver.daemon.assembly import assemble
from hilserver.errors import ConfigError

PATCH = {
    "schema": "hilserver.model_patch/1",
    "made_from": {
        "findings_sha256": "a" * 64,
        "config_sha256": "b" * 64,
        "version": "1",
    },
    "terms": {
        "rotation_gain": {
            "value": -0.47,
            "unit": "1",
            "ci95": [-0.48, -0.46],
            "fitted_in": {"speed_m_s": [-0.1, 0.5], "turn_rate_rad_s": [-1, 1]},
        }
    },
}


def write(folder, text, name="patch.yaml"):
    path = folder / name
    path.write_text(
        text if isinstance(text, str) else yaml.safe_dump(text), encoding="utf-8"
    )
    return path


def changed(**changes):
    """The patch with other entries in its only term."""
    term = PATCH["terms"]["rotation_gain"] | changes
    return PATCH | {"terms": {"rotation_gain": term}}


def test_its_terms_are_laid_over_the_plant(tmp_path):
    patch = load_patch(write(tmp_path, PATCH))
    plant = PlantConfig(terms={"side_slip": 0.1, "rotation_gain": None})
    assert patch.applied(plant).terms == {"side_slip": 0.1, "rotation_gain": -0.47}
    assert plant.terms["rotation_gain"] is None


def test_a_bare_cause_is_its_first_part(tmp_path):
    term = {"value": 0.08, "unit": "m"}
    patch = load_patch(write(tmp_path, PATCH | {"terms": {"nav_lever_arm": term}}))
    assert patch.applied(PlantConfig()).terms == {"nav_lever_arm.x": 0.08}
    with pytest.raises(ConfigError, match="sets this term as well"):
        patch.applied(PlantConfig(terms={"nav_lever_arm.x": 0.1}))


def test_its_hash_is_that_of_what_it_says(tmp_path):
    first = load_patch(write(tmp_path, PATCH)).sha256
    assert (
        load_patch(write(tmp_path, "# why\n" + yaml.safe_dump(PATCH))).sha256 == first
    )
    assert load_patch(write(tmp_path, changed(value=-0.471))).sha256 != first


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        ("{", "not YAML"),
        ("", "key 'schema' is missing"),
        (PATCH | {"schema": "hilserver.model_patch/2"}, "schema: "),
        (PATCH | {"more": 1}, "unknown key 'more'"),
        (
            PATCH | {"terms": {"rotation_gian": PATCH["terms"]["rotation_gain"]}},
            "did you mean",
        ),
        (changed(value=20), "terms.rotation_gain: 20 1 is outside"),
        (changed(value=float("nan")), "terms.rotation_gain.value"),
        (changed(unit="m"), "terms.rotation_gain.unit: the term has the unit '1'"),
        (changed(fitted_in={"speed_m_s": [1, 0]}), "falls"),
        (PATCH | {"made_from": {}}, "made_from.config_sha256"),
    ],
)
def test_a_bad_patch_is_told_in_words_with_exit_78(
    tmp_path, monkeypatch, capsys, content, complaint
):
    monkeypatch.chdir(tmp_path)
    write(tmp_path, content)
    assert main(["run", "--patch", "patch.yaml", "--duration", "1"]) == 78
    error = capsys.readouterr().err
    assert complaint in error
    assert error.startswith(("hilserver: patch.yaml", "patch.yaml"))
    assert "Traceback" not in error


def test_a_term_set_in_both_is_one_sentence_that_says_where(
    tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    write(tmp_path, "plant: {terms: {rotation_gain: 0.1}}\n", "config.yaml")
    write(tmp_path, PATCH)
    assert main(["run", "--patch", "patch.yaml", "--duration", "1"]) == 78
    (line,) = capsys.readouterr().err.splitlines()
    assert "terms.rotation_gain: the configuration sets this term as well" in line
    assert "patch.yaml:" in line


def test_a_term_that_the_robot_cannot_have_is_a_complaint_about_the_patch(tmp_path):
    delay = PATCH | {"terms": {"actuation_delay": {"value": 100, "unit": "s"}}}
    path = write(tmp_path, delay)
    with pytest.raises(ConfigError, match=r"patch\.yaml:\d+: terms\.actuation_delay: "):
        assemble(None, path)


def test_identity_and_provenance_carry_it(tmp_path):
    path = write(tmp_path, PATCH)
    assembly = assemble(None, path)
    assert assembly.identity == assemble(None).identity, (
        "it is that of the configuration"
    )
    assert assembly.provenance["patch"]["sha256"] == load_patch(path).sha256
    assert "patch" not in assemble(None).identity
    assert assemble(None).provenance["patch"] is None
    assert assembly.config == assemble(None).config


def test_a_patch_for_another_configuration_is_warned_about(tmp_path):
    assembly = assemble(None, write(tmp_path, PATCH))
    own = assembly.config.sha256
    assert "another configuration" in assembly.patch.notice(own)
    made = PATCH["made_from"] | {"config_sha256": own}
    fitting = load_patch(write(tmp_path, PATCH | {"made_from": made}))
    assert fitting.notice(own) is None


def grouped(**groups):
    """The patch with a shared term and others by group."""
    side = {"side_slip": {"value": 0.1, "unit": "s"}}
    own = {
        name: {"rotation_gain": {"value": v, "unit": "1"}} for name, v in groups.items()
    }
    return PATCH | {"terms": side, "groups": own}


def test_one_group_of_a_patch_is_taken(tmp_path):
    path = write(tmp_path, grouped(asphalt=-0.05, sand=-0.2))
    sand = load_patch(path, "sand")
    assert sand.applied(PlantConfig()).terms == {
        "side_slip": 0.1,
        "rotation_gain": -0.2,
    }
    assert sand.sha256 != load_patch(path, "asphalt").sha256
    assert patch_of({"patch": sand.provenance}).sha256 == sand.sha256
    assert "groups" not in sand.provenance["content"], (
        "as a patch without groups is recorded"
    )


@pytest.mark.parametrize(
    ("content", "words", "code", "complaint"),
    [
        (grouped(asphalt=0, sand=0), [], 78, "choose one with --group: asphalt, sand"),
        (
            grouped(asphalt=0, sand=0),
            ["mud"],
            78,
            "has no group 'mud'; it has asphalt, sand",
        ),
        (PATCH, ["sand"], 78, "has no groups; leave --group sand out"),
        (grouped(sand=20), ["sand"], 78, "groups.sand.rotation_gain: 20 1 is outside"),
    ],
)
def test_a_group_that_is_not_there_is_one_sentence(
    tmp_path, monkeypatch, capsys, content, words, code, complaint
):
    monkeypatch.chdir(tmp_path)
    write(tmp_path, content)
    group = [part for name in words for part in ("--group", name)]
    assert main(["run", "--patch", "patch.yaml", *group, "--duration", "1"]) == code
    (line,) = capsys.readouterr().err.splitlines()
    assert complaint in line


def test_a_group_without_a_patch_is_a_sentence(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["run", "--duration", "1", "--group", "sand"]) != 0
    assert "use it with --patch" in capsys.readouterr().err


def test_a_complaint_about_a_term_of_a_group_names_its_line(tmp_path):
    path = write(tmp_path, grouped(sand=-0.2))
    with pytest.raises(
        ConfigError, match=r"patch\.yaml:\d+: groups\.sand\.rotation_gain: "
    ):
        load_patch(path, "sand").applied(PlantConfig(terms={"rotation_gain": 0.1}))


def test_the_schema_accepts_what_the_model_accepts():
    schema = json.loads(schema_text(ModelPatch))
    validator = Draft202012Validator(schema)
    Draft202012Validator.check_schema(schema)
    assert validator.is_valid(PATCH)
    assert validator.is_valid(grouped(asphalt=0.0, sand=-0.2))
    assert not validator.is_valid(PATCH | {"more": 1})
    assert not validator.is_valid(changed(value="much"))


def test_a_flat_patch_of_900_kb_is_not_even_parsed(tmp_path):
    """Before, validating its terms held the event loop up for more than a second."""
    path = tmp_path / "flat.yaml"
    path.write_text(
        "terms:\n" + "".join(f"  t{i}: {{value: 1}}\n" for i in range(45_000))
    )
    with pytest.raises(ConfigError, match=r"flat\.yaml: larger than 100000 bytes"):
        load_patch(path)
