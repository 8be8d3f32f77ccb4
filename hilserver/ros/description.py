"""The robot's model as URDF, for RViz: chassis, wheels, range finders."""

from xml.sax.saxutils import quoteattr

from hilserver.plant.layout import WHEELS
from hilserver.ros.outgoing import PLACES
from hilserver.ros.robot import EDUART_ORDER, Shape

CHASSIS_HEIGHT_M, WHEEL_WIDTH_M, FINDER_HEIGHT_M = 0.08, 0.055, 0.05


def urdf(shape: Shape, prefix: str = "") -> str:
    """Return the model; `prefix` stands before the names of links and joints."""
    base, radius = f"{prefix}base_link", shape.wheel_radius_m
    length, width = shape.wheelbase_m + radius, max(shape.track_m - WHEEL_WIDTH_M, 0.02)
    parts = [
        _link(base, f'<box size="{length:g} {width:g} {CHASSIS_HEIGHT_M:g}"/>'),
    ]
    for wheel in WHEELS:
        name = f"{prefix}wheel_{PLACES[wheel]}"
        x = 0.5 * shape.wheelbase_m * (1 if wheel.startswith("f") else -1)
        y = 0.5 * shape.track_m * (1 if wheel.endswith("l") else -1)
        drum = f'<cylinder radius="{radius:g}" length="{WHEEL_WIDTH_M:g}"/>'
        parts += [
            _link(name, drum, 'rpy="1.5707963 0 0"'),
            f'<joint name={quoteattr(f"{prefix}base_to_wheel_{PLACES[wheel]}")} type="continuous">'
            f"<parent link={quoteattr(base)}/><child link={quoteattr(name)}/>"
            f'<origin xyz="{x:g} {y:g} 0"/><axis xyz="0 1 0"/></joint>',
        ]
    for place, x, y in zip(EDUART_ORDER, shape.tof_x_m, shape.tof_y_m, strict=False):
        name = f"{prefix}range/{PLACES[place].replace('_', '/')}"
        yaw = 0.0 if place.startswith("f") else 3.1415927
        parts += [
            f"<link name={quoteattr(name)}/>",
            f'<joint name={quoteattr(f"{prefix}base_to_range_{PLACES[place]}")} type="fixed">'
            f"<parent link={quoteattr(base)}/><child link={quoteattr(name)}/>"
            f'<origin xyz="{x:g} {y:g} {FINDER_HEIGHT_M:g}" rpy="0 0 {yaw:g}"/></joint>',
        ]
    return f'<robot name="hilserver">{"".join(parts)}</robot>'


def _link(name: str, geometry: str, turned: str = "") -> str:
    return (
        f"<link name={quoteattr(name)}><visual><origin {turned}/>"
        f"<geometry>{geometry}</geometry></visual></link>"
    )
