"""The keywords of an Attitude Ephemeris Message, by version of the standard: tables 4-2 and 4-3."""

HEADER = ("CLASSIFICATION", "CREATION_DATE", "ORIGINATOR", "MESSAGE_ID")
NEEDED_IN_HEADER = ("CREATION_DATE", "ORIGINATOR")
NEEDED = (
    "OBJECT_NAME", "OBJECT_ID", "REF_FRAME_A", "REF_FRAME_B", "TIME_SYSTEM", "START_TIME", "STOP_TIME", "ATTITUDE_TYPE",
)  # fmt: skip
METADATA = (
    *NEEDED, "CENTER_NAME", "USEABLE_START_TIME", "USEABLE_STOP_TIME", "EULER_ROT_SEQ", "INTERPOLATION_METHOD",
    "INTERPOLATION_DEGREE",
)  # fmt: skip
ONLY_IN = {"1.0": ("ATTITUDE_DIR", "QUATERNION_TYPE", "RATE_FRAME"), "2.0": ("ANGVEL_FRAME",)}


def needed_in(version: str, form: str) -> tuple[str, ...]:
    """The required keywords of the metadata, for an ATTITUDE_TYPE."""
    more = ["ATTITUDE_DIR"] if version == "1.0" else []
    if version == "1.0" and form.startswith("QUATERNION"):
        more.append("QUATERNION_TYPE")
    if form.startswith("EULER_ANGLE"):
        more.append("EULER_ROT_SEQ")
    if form.endswith("/ANGVEL"):
        more.append("ANGVEL_FRAME")
    return (*NEEDED, *more)
