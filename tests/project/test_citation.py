"""CITATION.cff: the keys of its schema (Citation File Format 1.2.0), and agreement with the package."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import yaml

ROOT = Path(__file__).parents[2]
PERSON = {"family-names", "given-names", "orcid", "affiliation", "email", "website", "alias", "name-suffix"}
ENTITY = {"name", "website", "email", "orcid", "address", "city", "country", "alias"}
KNOWN = {
    "cff-version", "message", "type", "title", "abstract", "version", "license", "authors", "keywords", "references",
    "date-released", "doi", "identifiers", "repository-code", "url", "commit", "contact", "preferred-citation",
}  # fmt: skip


def test_the_citation_keeps_the_schema_and_agrees_with_the_package() -> None:
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    package = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert {"cff-version", "message", "title", "authors"} <= set(cited) <= KNOWN
    assert cited["cff-version"] == "1.2.0"
    assert cited["type"] in {"software", "dataset"}
    assert (cited["title"], cited["version"], cited["license"]) == (
        package["name"],
        package["version"],
        package["license"],
    )
    for work in (cited, *cited["references"]):
        assert {"authors", "title"} <= set(work)
        for author in work["authors"]:
            assert set(author) <= (ENTITY if "name" in author else PERSON)
    assert all(re.fullmatch(r"[a-z-]+", reference["type"]) for reference in cited["references"])
