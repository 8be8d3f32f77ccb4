"""What the operator page has to know, taken from an assembly."""

from dataclasses import replace
from math import isnan
from pathlib import Path
from typing import Any

from hilserver.config.mechatronic import MechatronicConfig
from hilserver.config.page import PageConfig
from hilserver.config.server import OpcUaConfig
from hilserver.core.parameters import Start
from hilserver.daemon.assembly import Assembly
from hilserver.faults.model import FORMS
from hilserver.io.page.setup import OpcUaAccess, Serving, Setup
from hilserver.measured.builtin import builtin_mappings
from hilserver.opcua.access import Access
from hilserver.opcua.settings import SECURE_POLICIES, default_application_uri
from hilserver.plant.parameters import RobotParameters


def _geometry(robot: RobotParameters, body: MechatronicConfig) -> dict[str, Any]:
    """Return what the page draws the robot with."""
    tof = robot.tof
    is_bodily = body.enabled and body.sensors == "body"
    return {
        "wheel_radius_m": robot.wheel_radius_m,
        "wheelbase_m": robot.wheelbase_m,
        "track_m": robot.track_m,
        "max_rpm": robot.max_rpm,
        "max_linear_m_s": robot.max_linear_m_s,
        "max_angular_rad_s": robot.max_angular_rad_s,
        "tof_x_m": tof.mount_x_m,
        "tof_y_m": tof.mount_y_m,
        "tof_field_rad": tof.field_of_view_rad,
        "mass_height_m": body.centre_of_mass_m[2],
        "has_body": body.enabled,
        "body_senses": is_bodily,
    }


def page_setup(
    assembly: Assembly, image: str, endpoint: str, secret: str = ""
) -> Setup:
    """Return what a page of this robot has to know."""
    config = assembly.config
    folder = assembly.folder
    paths = config.folders.model_dump() | {"snapshots": config.snapshots.folder}
    walls = assembly.composition.hall.reshape(-1, 4).tolist()
    rows = [
        {
            "name": s.name,
            "unit": "" if s.unit == "1" else s.unit,
            "type": s.type.value,
            "writable": s.writable,
            "labels": s.labels,
            "low": s.low,
            "high": s.high,
            "description": s.description,
            "slot": s.slots[0],
        }
        for s in assembly.table
        if not s.is_array
    ]
    forms = [
        {
            "name": name,
            "text": f.text,
            "needs": f.needs,
            "takes": f.takes,
            "on": f.on,
        }
        for name, f in FORMS.items()
    ]
    folders = {name: str((folder / path).absolute()) for name, path in paths.items()}
    config_file = "" if assembly.path is None else str(assembly.path.absolute())
    return Setup(
        image=image,
        page=_serving(config.page, folder),
        opcua=_access(config.opcua, folder, endpoint, secret),
        signals=rows,
        robot=_geometry(assembly.robot, config.mechatronic),
        walls=walls,
        faults=forms,
        parameters=_parameters(assembly),
        mappings=list(builtin_mappings()),
        folders=folders,
        config_file=config_file,
    )


def _serving(page: PageConfig, folder: Path) -> Serving:
    given = page.model_dump(
        include={"host", "port", "rate_hz", "deadman_ms", "max_clients"}
    )
    if page.tls is not None:
        given |= {
            name: str(folder / path) for name, path in page.tls.model_dump().items()
        }
    return Serving(**given)


def _parameters(assembly: Assembly) -> list[dict[str, Any]]:
    start = Start(assembly.robot, assembly.configured, assembly.composition)
    configured = start.values
    return [
        {
            "name": p.name,
            "unit": "" if p.unit == "1" else p.unit,
            "low": p.low,
            "high": p.high,
            "configured": None if isnan(configured[p.name]) else configured[p.name],
            "nullable": p.nullable,
            "flag": p.is_flag,
            "names": {}
            if p.is_flag
            else {n: None if isnan(v) else v for n, v in p.names},
            "fixed": p.when == "restart",
            "meaning": p.meaning,
        }
        for p in start.table.values()
    ]


def _access(
    opcua: OpcUaConfig, folder: Path, endpoint: str, secret: str
) -> OpcUaAccess:
    """Return how the page logs in: encrypted wherever a password travels."""
    judge = Access(opcua)
    anonymous = judge.anonymous()
    url = endpoint if opcua.enabled else ""
    may_stop = anonymous is not None and judge.may_call(anonymous, "Stop")
    access = OpcUaAccess(
        endpoint=url,
        secret=secret,
        needs_login=opcua.anonymous_role is None,
        anonymous_may_stop=may_stop,
        max_failed_logins=opcua.max_failed_logins,
    )
    secure = [policy for policy in opcua.offered_policies if policy in SECURE_POLICIES]
    if not secure or not (opcua.is_secure or access.needs_login):
        return access
    own = folder / opcua.certificates / "own"
    key = str(folder / (opcua.private_key or own / "key.pem"))
    uri = opcua.application_uri or default_application_uri()
    return replace(
        access,
        policy=secure[0],
        certificate=str(own / "certificate.der"),
        key=key,
        application_uri=uri,
    )
