"""Names of the measuring methods; every record names its own."""

from typing import Final, Literal

Method = Literal["solitary_wave", "pulse_echo"]
SOLITARY_WAVE: Final = "solitary_wave"
PULSE_ECHO: Final = "pulse_echo"
