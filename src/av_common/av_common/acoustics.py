"""The speed of sound, and what a body does to its delays."""

BODY_STRETCH = 1.5  # of delays of low frequencies between microphones on either side of a sphere (Kuhn, 1977)


def speed_of_sound(temperature_c: float = 20.0) -> float:
    """Speed of sound in dry air (m/s): ideal gas, within 0.1 % of ISO 9613-1 eq. A.5.

    Parameters:
        temperature_c (degrees Celsius): temperature of the air.

    Raises ValueError outside of -60..60 degrees, where the unit is probably wrong.
    """
    if not -60.0 <= temperature_c <= 60.0:
        raise ValueError(f'temperature_c is {temperature_c}, expected degrees Celsius between -60 and 60')
    return 331.3 * (1.0 + temperature_c / 273.15) ** 0.5
