import numpy as np

from dgc_pose.benchmarks.map_figure import MapPicture, plot_maps


def picture(title: str) -> MapPicture:
    rng = np.random.default_rng(0)
    image1 = rng.integers(0, 256, (20, 30, 3), dtype=np.uint8)
    y, x = np.mgrid[:20, :30].astype(np.float32)
    return MapPicture(title, image1, image1, np.stack([x, y], -1), np.zeros((20, 30)))


def test_a_row_a_pair_with_the_warped_source_third():
    figure = plot_maps([picture("first"), picture("second")])
    panels = [axes for axes in figure.axes if axes.images]
    titles = [axes.get_title(loc="left") for axes in panels]
    assert titles[::4] == ["first", "second"]
    assert titles[1:4] == titles[5:] == ["target", "source, warped", "error"]
    # The identity warps the source to itself.
    np.testing.assert_array_equal(panels[2].images[0].get_array(), panels[0].images[0].get_array())
    figure.canvas.draw()


def test_errors_are_bright_and_grey_where_nothing_is_known():
    wrong = picture("wrong")
    wrong.errors[0, :5] = 0, 10, 20, 1e6, np.inf
    panels = [axes for axes in plot_maps([wrong]).axes if axes.images]
    good, bad, worst, beyond, unknown = panels[3].images[0].get_array().astype(int)[0, :5]
    assert good.sum() < bad.sum() < worst.sum()
    assert beyond.tolist() == worst.tolist()
    assert len(set(unknown.tolist())) == 1
