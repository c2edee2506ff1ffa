"""Terminal members that several blocks have. A member has the same meaning in every block."""

END_EFFECTOR = {
    "position": "end_effector_position",
    "orientation": "end_effector_orientation",
    "velocity": "end_effector_velocity",
}
REFERENCE = ("position", "orientation", "velocity", "acceleration")
