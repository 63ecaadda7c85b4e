"""Figures of merit against cases worked out by hand."""

import numpy as np
import pytest

from ohmskin.errors import DataError
from ohmskin.evaluate.merit import Target, eidors_figures, figures_of_merit
from ohmskin.geometry import Raster, Rectangle, mesh_domain

EXACT = 1e-12
PITCH = 2e-3


def canvas(columns: int, rows: int, origin: tuple[float, float] = (0.0, 0.0)):
    """An empty image and its pixel centres, the domain's lower left corner at `origin`."""
    x = origin[0] + PITCH * (np.arange(columns) + 0.5)
    y = origin[1] + PITCH * (np.arange(rows) + 0.5)
    return np.zeros((rows, columns)), x, y


# pixels (row, column) relative to the middle, and the share outside the circle of their area, by hand:
# plus: 5 pixels, radius sqrt(5/pi) = 1.26 > 1; square: 9, 1.69 > 1.41; bar of 4: 1.13, its ends are 1.5 away;
# ring of 8: 1.60 > 1.41
SHAPES = {
    "plus": ([(0, 0), (0, 1), (0, -1), (1, 0), (-1, 0)], 0.0),
    "square": ([(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1)], 0.0),
    "ring": ([(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if (i, j) != (0, 0)], 0.0),
    "bar of 7": ([(0, j) for j in range(-3, 4)], 4 / 7),  # radius 1.49: three stay
}


@pytest.mark.parametrize("origin", [(0.0, 0.0), (-0.3, 1.7)])
@pytest.mark.parametrize(("columns", "rows"), [(20, 20), (40, 12)])
@pytest.mark.parametrize("name", SHAPES)
def test_shapes_by_hand(name: str, columns: int, rows: int, origin: tuple[float, float]) -> None:
    pixels, deformation = SHAPES[name]
    image, x, y = canvas(columns, rows, origin)
    for i, j in pixels:
        image[6 + i, 9 + j] = 3.0
    target = Target((float(x[9]) + 0.7e-3, float(y[6]) - 0.4e-3), strength=2e-5)
    merit = figures_of_merit(image, x, y, [target])[0]
    n = len(pixels)
    assert merit.position_error == pytest.approx((-0.7e-3, 0.4e-3), abs=EXACT)
    assert merit.distance == pytest.approx(np.hypot(0.7e-3, 0.4e-3), abs=EXACT)
    assert merit.amplitude_response == pytest.approx(3.0 * n * PITCH**2 / 2e-5, abs=EXACT)
    assert merit.resolution == pytest.approx(np.sqrt(n / (columns * rows)), abs=EXACT)
    assert merit.shape_deformation == pytest.approx(deformation, abs=EXACT)
    assert merit.area == pytest.approx(n * PITCH**2, abs=EXACT)
    assert (merit.ringing, merit.peak) == (0.0, 3.0)


def test_only_pixels_at_or_above_a_quarter_of_the_largest_count() -> None:
    image, x, y = canvas(20, 20)
    image[5, 5:8] = (4.0, 1.0, 0.999)
    merit = figures_of_merit(image, x, y, [Target((0.0, 0.0), 1.0)])[0]
    assert merit.position_error[0] == pytest.approx((x[5] + x[6]) / 2, abs=EXACT)


def test_ringing_counts_what_is_negative_outside_the_circle() -> None:
    image, x, y = canvas(20, 20)
    for i, j in SHAPES["ring"][0]:
        image[8 + i, 8 + j] = 1.0
    image[8, 8] = -0.5  # inside the circle of the ring's area
    image[8, 11] = -0.2  # outside
    image[15, 15] = 0.1  # positive and outside: no ringing
    merit = figures_of_merit(image, x, y, [Target((0.0, 0.0), 1.0)])[0]
    assert merit.ringing == pytest.approx(0.2 / 7.5, abs=EXACT)
    # EIDORS counts what is negative outside q, and divides by the sum over q
    assert eidors_figures(image, (0.0, 0.0)).ringing == pytest.approx(0.7 / 8, abs=EXACT)


def test_each_target_is_judged_in_its_own_cell() -> None:
    image, x, y = canvas(30, 10)
    for i, j in SHAPES["plus"][0]:
        image[5 + i, 5 + j], image[5 + i, 24 + j] = 1.0, 10.0  # the weak one is below a quarter of the strong one
    targets = [Target((float(x[5]), float(y[5])), 1e-5), Target((float(x[24]), float(y[4])), 1e-4)]
    weak, strong = figures_of_merit(image, x, y, targets)
    assert weak.position_error == pytest.approx((0, 0), abs=EXACT)
    assert strong.position_error == pytest.approx((0, PITCH), abs=EXACT)
    assert (weak.peak, strong.peak) == (1.0, 10.0)
    assert weak.amplitude_response == pytest.approx(strong.amplitude_response, abs=EXACT)
    assert weak.shape_deformation == strong.shape_deformation == 0.0


def test_pixels_off_the_domain_do_not_count() -> None:
    image, x, y = canvas(20, 20)
    image[4, 4] = 1.0
    image[:, 10:] = np.nan
    merit = figures_of_merit(image, x, y, [Target((float(x[4]), float(y[4])), 1.0)])[0]
    assert merit.resolution == pytest.approx(np.sqrt(1 / 200), abs=EXACT)
    assert merit.distance == pytest.approx(0, abs=EXACT)


@pytest.mark.parametrize(("width", "height"), [(0.2, 0.2), (0.3, 0.1), (0.07, 0.2)])
def test_the_raster_is_exact_about_pixel_centres_on_oblong_sheets(width: float, height: float) -> None:
    mesh = mesh_domain(Rectangle(width, height), 0.011)
    raster = Raster(mesh, 60)
    assert raster.x[0] == pytest.approx(raster.pitch / 2, abs=EXACT)
    assert raster.x[-1] == pytest.approx(width - raster.pitch / 2, abs=EXACT)
    assert raster.y[0] + raster.y[-1] == pytest.approx(height, abs=EXACT)
    pixels = np.where(raster.inside, 0.0, np.nan)
    pixels[3, 5] = 1.0
    at = (float(raster.x[5]), float(raster.y[3]))
    merit = figures_of_merit(pixels, raster.x, raster.y, [Target(at, 1.0)])[0]
    assert merit.distance == pytest.approx(0, abs=EXACT)
    assert merit.amplitude_response == pytest.approx(raster.pitch**2, abs=EXACT)


def test_a_position_error_along_the_tangent_is_seen_here_and_not_by_eidors() -> None:
    image = np.zeros((65, 65))
    axis = np.linspace(-1, 1, 65)
    image[32, 48] = 1.0  # EIDORS: at (0.5, 0)
    assert eidors_figures(image, (0.0, 0.5)).position_error == pytest.approx(0, abs=EXACT)
    assert eidors_figures(image, (0.8, 0.0)).position_error == pytest.approx(0.3, abs=EXACT)
    assert figures_of_merit(image, axis, axis, [Target((0.0, 0.5), 1.0)])[0].distance == pytest.approx(
        np.sqrt(0.5), abs=EXACT
    )


def test_eidors_by_hand() -> None:
    image = np.zeros((64, 64))
    image[31:33, 31:33] = 2.0
    image[0, 0] = 100.0  # in the corner that its search leaves out
    image[20, 20] = -1.0
    found = eidors_figures(image, (0.3, 0.4))
    assert found.amplitude_response == pytest.approx(107.0, abs=EXACT)
    assert found.position_error == pytest.approx(0.5, abs=EXACT)
    assert found.resolution == pytest.approx(2 / 64, abs=EXACT)
    assert found.ringing == pytest.approx(1 / 8, abs=EXACT)
    # pixels lie 2/63 apart, the circle is measured with 2/64: radius 0.0353 reaches all four at 0.0224
    assert found.shape_deformation == 0.0


def test_eidors_measures_from_the_origin_of_the_mesh_and_has_a_sixth_figure() -> None:
    """A sheet of 0.2 by 0.1 m with its origin at a corner: the centroid is 0.1118 m from there, not in the middle."""
    image = np.zeros((65, 65))
    image[31:34, 31:34] = 2.0
    image[5, 32] = -0.5
    found = eidors_figures(image, (0.15, 0.2), (0.0, 0.0, 0.2, 0.1))
    assert found.position_error == pytest.approx(0.25 - np.hypot(0.1, 0.05), abs=EXACT)
    assert found.region_amplitude_response == pytest.approx(18.0, abs=EXACT)
    assert found.amplitude_response == pytest.approx(17.5, abs=EXACT)
    # pixels lie 3.1 and 1.6 mm apart, the corners of q 3.5 mm from its centre; the circle of nine has 3.7 mm
    assert found.shape_deformation == 0.0
    at_centre = eidors_figures(image, (0.3, 0.0))
    assert at_centre.position_error == pytest.approx(0.3, abs=EXACT)
    with pytest.raises(DataError, match="give least x and y"):
        eidors_figures(image, (0.0, 0.0), (0.0, 0.0, -1.0, 1.0))


def test_the_search_of_eidors_hides_17_3_per_cent_of_a_square() -> None:
    assert eidors_figures(np.ones((64, 64)), (0.0, 0.0)).resolution ** 2 == pytest.approx(1 - 0.1728515625, abs=EXACT)


def test_rows_and_columns_may_go_in_either_direction() -> None:
    image, x, y = canvas(9, 9)
    image[3:6, 2:5] = 1.0
    image[7, 7] = -0.5
    targets = [Target((0.0, 0.0), 1.0)]
    found = figures_of_merit(image, x, y, targets)[0]
    assert found.amplitude_response > 0
    for turned in (
        figures_of_merit(image[::-1], x, y[::-1], targets)[0],
        figures_of_merit(image[:, ::-1], x[::-1], y, targets)[0],
    ):
        for name in ("amplitude_response", "position_error", "shape_deformation", "ringing", "area"):
            assert getattr(turned, name) == pytest.approx(getattr(found, name), abs=EXACT)


def test_what_cannot_be_judged_is_refused() -> None:
    image, x, y = canvas(6, 5)
    with pytest.raises(DataError, match="strength must be finite, and the strength not 0"):
        figures_of_merit(image, x, y, [Target((0.0, 0.0), 0.0)])
    with pytest.raises(DataError, match="not evenly spaced"):
        figures_of_merit(image, x**3, y, [Target((0.0, 0.0), 1.0)])
    with pytest.raises(DataError, match="infinite pixels"):
        figures_of_merit(np.full_like(image, np.inf), x, y, [Target((0.0, 0.0), 1.0)])
    with pytest.raises(DataError, match="nothing positive"):
        figures_of_merit(image, x, y, [Target((0.0, 0.0), 1.0)])
    with pytest.raises(DataError, match="shape"):
        figures_of_merit(image.T, x, y, [Target((0.0, 0.0), 1.0)])
    with pytest.raises(DataError, match="no target"):
        figures_of_merit(image, x, y, [])
    with pytest.raises(DataError, match="square"):
        eidors_figures(image, (0.0, 0.0))
