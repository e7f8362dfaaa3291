"""The schemas of JSON files: valid, as the code is, and the source of the tables on the page of files."""

from dataclasses import fields
from pathlib import Path
from types import NoneType, UnionType
from typing import Literal, get_args, get_origin

import pytest
from jsonschema import Draft202012Validator

from regtorch.geometry import KEYS, NAMES, VIEWS
from regtorch.registration import Evidence
from regtorch.registration.trace import Step
from regtorch.registration.trust.rules import Reason
from tests.docs.test_docs import reference

FOLDER = Path(__file__).parents[2] / "docs" / "reference"
NAMES_OF_SCHEMAS = sorted(path.name.removesuffix(".schema.json") for path in (FOLDER / "schemas").iterdir())
CLOSED = {"parameters", "detector"}
TYPES = {
    bool: "boolean",
    int: "integer",
    float: "number",
    str: "string",
    Literal: "string",
    tuple: "array",
    NoneType: "null",
}


def objects(name: str) -> dict[str | None, dict]:
    """The objects with named keys of a schema: itself, and its definitions by name."""
    schema = reference.schema(name)
    return {None: schema} | {key: told for key, told in schema["$defs"].items() if "properties" in told}


@pytest.mark.parametrize("name", NAMES_OF_SCHEMAS)
def test_a_schema_is_valid_and_names_its_draft(name):
    schema = reference.schema(name)
    Draft202012Validator.check_schema(schema)
    assert schema["$schema"] == "https://json-schema.org/draft/2020-12/schema"
    assert f"(schemas/{name}.schema.json)" in (FOLDER / "files.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("name", NAMES_OF_SCHEMAS)
def test_every_object_says_whether_it_may_grow(name):
    for part, told in objects(name).items():
        assert told["additionalProperties"] is (part not in CLOSED), part
        assert set(told["required"]) <= set(told["properties"]), part
        assert all(entry["description"] for entry in told["properties"].values()), part


def test_the_tables_of_the_page_are_those_of_the_schemas():
    page = (FOLDER / "files.md").read_text(encoding="utf-8")
    assert page == reference.files(), "run python docs/build_reference.py"


def test_every_object_has_its_table():
    shown = set(reference.TABLES.values())
    for name in NAMES_OF_SCHEMAS:
        repeated = CLOSED if name != "result" else set()
        assert {(name, part) for part in objects(name) if part not in repeated} <= shown


def test_definitions_that_schemas_share_are_equal():
    found = {}
    for name in NAMES_OF_SCHEMAS:
        for part, told in reference.schema(name)["$defs"].items():
            assert found.setdefault(part, told) == told, f"{name}: {part}"


@pytest.mark.parametrize(("part", "kind"), [("evidence", Evidence), ("step", Step), ("reason", Reason)])
def test_an_object_of_the_result_has_the_fields_of_its_class(part, kind):
    told = reference.schema("result")["$defs"][part]
    assert told["required"] == list(told["properties"]) == [field.name for field in fields(kind)]
    for field in fields(kind):
        written = told["properties"][field.name].get("type", "string")
        assert _types(field.type) <= ({written} if isinstance(written, str) else set(written)), field.name


def _types(kind) -> set[str]:
    """JSON's names of a field's type; a float may besides be null, where it is not finite."""
    parts = get_args(kind) if isinstance(kind, UnionType) else (kind,)
    return {TYPES[get_origin(part) or part] for part in parts}


def test_names_of_parameters_and_views_are_those_of_the_code():
    definitions = reference.schema("result")["$defs"]
    assert definitions["parameters"]["required"] == list(definitions["parameters"]["properties"]) == list(KEYS)
    assert definitions["view"]["enum"] == list(VIEWS)
    for key in ("frozen", "at_limit"):
        assert definitions["evidence"]["properties"][key]["items"]["enum"] == list(NAMES)
