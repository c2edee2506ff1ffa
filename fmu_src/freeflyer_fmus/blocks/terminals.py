"""Members of the terminals that many blocks share; a member has the same meaning in every block."""

HAND = {
    "position": "end_effector_position",
    "orientation": "end_effector_orientation",
    "velocity": "end_effector_velocity",
}
REFERENCE = ("position", "orientation", "velocity", "acceleration")
