"""How the scene is lit."""

from __future__ import annotations

import viser


def shine(api: viser.SceneApi) -> None:
    """Even light with one main direction, so that shapes read without hard shadows."""
    # viser's own lights wash out light colours such as bone.
    api.configure_default_lights(False, cast_shadow=False)
    # No environment map: reflections on bone say little, and without a graphics card they cost some
    # hundred times what all the rest of the picture does.
    api.configure_environment_map(None)
    api.add_light_hemisphere(
        "/light/sky", sky_color=(255, 255, 255), ground_color=(150, 140, 130), intensity=1.7
    )
    api.add_light_directional("/light/sun", intensity=1.9, position=(60.0, 10.0, 60.0))
