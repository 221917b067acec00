"""Principal points of some cameras, by bundle adjustment of a model of COLMAP's own."""

import numpy as np
import pycolmap

from dgc_pose.colmap.reconstruction import adjust


def test_the_principal_points_of_some_cameras_are_found() -> None:
    """Those of a third of the images, which were 30 px off; no other camera changes."""
    pycolmap.set_random_seed(0)
    options = pycolmap.SyntheticDatasetOptions()
    options.num_rigs, options.num_frames_per_rig, options.num_points3D = 3, 4, 200
    model = pycolmap.synthesize_dataset(options)
    true = {key: np.array(camera.params) for key, camera in model.cameras.items()}
    cut = min(model.cameras)
    names = [image.name for image in model.images.values() if image.camera_id == cut]
    params = true[cut].copy()
    params[[-3, -2] if len(params) == 4 else [-2, -1]] += (30.0, -20.0)
    model.cameras[cut].params = params
    adjust(model, [], centres=True)
    np.testing.assert_array_equal(model.cameras[cut].params, params)
    adjust(model, names, centres=True)
    np.testing.assert_allclose(model.cameras[cut].params, true[cut], atol=0.05)
    for key in model.cameras.keys():  # noqa: SIM118, pycolmap's map
        if key != cut:
            np.testing.assert_array_equal(model.cameras[key].params, true[key])
