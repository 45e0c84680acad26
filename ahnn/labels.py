"""Labels and units of state components in output; velocities are named only if p = m dq/dt."""

from __future__ import annotations

from ahnn.errors import UserError
from ahnn.types import Space

KILOGRAMS = {"m": "kg m/s", "rad": "kg m²/s"}
"""Unit of a momentum by the unit of its position, with energies in J and times in s."""


def quantity(space: Space, name: str) -> tuple[str, str]:
    """Return the label and unit of `position`, `velocity` or `energy`.

    Momenta that are not mass times velocity are shown instead of velocities. If only some coordinates are
    angles, both units are named.
    """
    if name != "energy" and len(kinds := [*dict.fromkeys(space.angular)]) > 1:
        parts = [quantity(of_coordinates(space, angle=angle), name) for angle in kinds]
        return parts[0][0], ", ".join(dict.fromkeys(unit for _, unit in parts))
    if name == "velocity" and not space.mechanical:
        return "momentum", momentum_unit(space)
    return name, getattr(space.units, name)


def headed(space: Space, name: str) -> str:
    """Return the label of a quantity with its unit."""
    return "{} [{}]".format(*quantity(space, name))


def components(space: Space) -> list[str]:
    """Return the names of the components with their units, as converted by `Space.scales`."""
    scales = zip(space.components, space.scales.tolist(), strict=True)
    names = [name if scale == 1.0 else f"{name} / m" for name, scale in scales]
    found = []
    for k, name in enumerate(names):
        alike = of_coordinates(space, angle=space.angular[k % space.dof])
        found.append(f"{name} [{quantity(alike, 'velocity' if k >= space.dof else 'position')[1]}]")
    return found


def physical_components(space: Space) -> list[str]:
    """Return the names of positions and their velocities, or of general momenta, with units."""
    if not space.mechanical:
        return components(space)
    alike = [of_coordinates(space, angle=angle).units for angle in space.angular]
    positions = [*zip(space.components[: space.dof], alike, strict=True)]
    return [*(f"{q} [{u.position}]" for q, u in positions), *(f"v{q} [{u.velocity}]" for q, u in positions)]


def of_coordinates(space: Space, *, angle: bool) -> Space:
    """Return a space with uniform units, for coordinates that are all angles or all lengths."""
    if angle and space.units.position != "rad":
        units = space.units._replace(position="rad", velocity=f"rad/{space.units.time}")
        return space._replace(units=units)
    return space._replace(angles=())


def duration(value: float, space: Space) -> str:
    """Return a time or duration with its unit, without one if the system is dimensionless."""
    return f"{value:g} {space.units.time}".removesuffix(" 1")


def momentum_unit(space: Space) -> str:
    """Return the unit of the momenta p of a state."""
    time, position, velocity, energy = space.units
    if not space.mechanical and {time, position, energy} == {"1"}:
        return "1"
    if space.mechanical or energy.replace("²", "") == velocity:  # energies are per unit mass
        return velocity if space.inertia == 1 else f"{velocity} · mass"
    if (energy, time) == ("J", "s") and position in KILOGRAMS:
        return KILOGRAMS[position]
    return f"{energy} {time}/{position}"


def require_velocities(space: Space, who: str) -> None:
    """Raise UserError for reading or writing velocities where momenta are not mass times velocity."""
    if not space.mechanical:
        message = (
            f"{who}: expected momenta equal to mass times velocity; received {space.name}, where they "
            "differ. Use a table"
        )
        raise UserError(message)
