"""Lights of the scene."""

from __future__ import annotations

import viser


def add_lights(api: viser.SceneApi) -> None:
    """Hemisphere light and one directional light, without shadows."""
    # viser's own lights wash out light colours such as bone.
    api.configure_default_lights(False, cast_shadow=False)
    # Without a graphics card an environment map takes some hundred times the time of all the rest.
    api.configure_environment_map(None)
    api.add_light_hemisphere(
        "/light/sky", sky_color=(255, 255, 255), ground_color=(150, 140, 130), intensity=1.7
    )
    api.add_light_directional("/light/sun", intensity=1.9, position=(60.0, 10.0, 60.0))
