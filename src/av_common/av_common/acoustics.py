"""The speed of sound."""


def speed_of_sound(temperature_c: float = 20.0) -> float:
    """Speed of sound in dry air in m/s at a temperature in degrees Celsius (ideal gas, ISO 9613-1 eq. A.5 within 0.1 %).

    Raises ValueError outside -60..60 degrees, where no rig works and a unit was probably mixed up.
    """
    if not -60.0 <= temperature_c <= 60.0:
        raise ValueError(f'temperature_c is {temperature_c}, expected degrees Celsius between -60 and 60')
    return 331.3 * (1.0 + temperature_c / 273.15) ** 0.5
