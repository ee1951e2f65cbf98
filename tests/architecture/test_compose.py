"""The compose file without a container engine: its schema, its files, and addresses that fit together."""

import json
import subprocess
import sys
from pathlib import Path, PurePosixPath
from urllib.parse import urlsplit

import pytest
import yaml
from fastapi.routing import APIRoute

from daq_service.web.routes.metrics import probes

ROOT = Path(__file__).parents[2]
FILE = ROOT / "examples" / "compose.yaml"
COMPOSE = yaml.safe_load(FILE.read_text(encoding="utf-8"))
SERVICES = COMPOSE["services"]
CONTENTS = {name: yaml.safe_load(config["content"]) for name, config in COMPOSE["configs"].items()}
"""Each file that is mounted from the text of the compose file."""
DOCKERFILE = (ROOT / "examples/container/Dockerfile").read_text(encoding="utf-8")
BOARD = json.loads((ROOT / "examples/grafana/solimon.json").read_text(encoding="utf-8"))


def test_the_file_has_the_shape_of_the_compose_specification():
    command = [sys.executable, "-m", "check_jsonschema", "--builtin-schema", "vendor.compose-spec", str(FILE)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_everything_that_is_mounted_or_built_exists():
    build = SERVICES["twin"]["build"]
    assert ((FILE.parent / build["context"]).resolve() / build["dockerfile"]).is_file()
    used = set()
    for service in SERVICES.values():
        for volume in service["volumes"]:
            source = volume.partition(":")[0]
            assert source in COMPOSE["volumes"] or (FILE.parent / source).is_dir()
        used |= {config["source"] for config in service.get("configs", ())}
    assert used == CONTENTS.keys()


def test_the_test_s_data_are_kept_in_a_volume():
    assert SERVICES["twin"]["volumes"] == ["data:/data"]
    assert "VOLUME /data\n" in DOCKERFILE


def test_prometheus_asks_the_service_where_it_answers():
    (job,) = CONTENTS["scrape"]["scrape_configs"]
    (target,) = job["static_configs"][0]["targets"]
    port = json.loads(DOCKERFILE.rpartition("\nCMD ")[2])[-1]
    assert target == f"127.0.0.1:{port}"
    path = job.get("metrics_path", "/metrics")
    assert [route.path for route in probes.routes if isinstance(route, APIRoute)].count(path) == 1
    assert {service["network_mode"] for service in SERVICES.values()} == {"host"}


def test_grafana_asks_prometheus_and_is_reached_from_this_computer_only():
    (source,) = CONTENTS["datasource"]["datasources"]
    address = urlsplit(source["url"]).netloc
    assert f"--web.listen-address={address}" in SERVICES["prometheus"]["command"]
    environment = SERVICES["grafana"]["environment"]
    addresses = {address, f"{environment['GF_SERVER_HTTP_ADDR']}:{environment['GF_SERVER_HTTP_PORT']}"}
    addresses.add(CONTENTS["scrape"]["scrape_configs"][0]["static_configs"][0]["targets"][0])
    assert {one.partition(":")[0] for one in addresses} == {"127.0.0.1"}
    assert len(addresses) == 3, "ports of their own on one network"
    head = "".join(line for line in FILE.read_text(encoding="utf-8").splitlines() if line.startswith("#"))
    assert [one for one in addresses if f"http://{one}" not in head] == []


def test_the_board_s_data_come_from_the_provisioned_source():
    (source,) = CONTENTS["datasource"]["datasources"]
    choice, *_ = BOARD["templating"]["list"]
    assert (choice["type"], choice["query"]) == ("datasource", source["type"])
    # The variable takes the default source; each panel asks it.
    assert source["isDefault"] is True
    wanted = {"type": source["type"], "uid": f"${choice['name']}"}
    assert [panel["title"] for panel in BOARD["panels"] if panel["datasource"] != wanted] == []


@pytest.mark.parametrize("name", ["datasource", "boards"])
def test_grafana_reads_what_is_mounted_for_it(name):
    assert CONTENTS[name]["apiVersion"] == 1
    (target,) = [item["target"] for item in SERVICES["grafana"]["configs"] if item["source"] == name]
    folder = {"datasource": "datasources", "boards": "dashboards"}[name]
    assert PurePosixPath(target).parent == PurePosixPath("/etc/grafana/provisioning") / folder


def test_the_board_is_found_and_is_the_first_page():
    (provider,) = CONTENTS["boards"]["providers"]
    (volume,) = SERVICES["grafana"]["volumes"]
    source, target, mode = volume.split(":")
    assert (target, mode) == (provider["options"]["path"], "ro")
    home = SERVICES["grafana"]["environment"]["GF_DASHBOARDS_DEFAULT_HOME_DASHBOARD_PATH"]
    assert PurePosixPath(home).parent == PurePosixPath(target)
    assert (FILE.parent / source / PurePosixPath(home).name).is_file()
