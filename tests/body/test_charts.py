"""Charts of bodies and certificates: what is drawn with Matplotlib, and the same as plain values for pages."""

import numpy as np
import pytest

from morembs import campbell, read_body
from morembs.app.jobs.job import load_job
from morembs.app.jobs.run import run_job
from morembs.base.charts import Chart, Curve, Panel
from morembs.body.charts import cost_chart, density_chart, mac_chart, response_chart
from morembs.certificate.charts import certificate_chart
from tests.support import decks
from tests.support.refusals import refusal


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    folder = tmp_path_factory.mktemp("charts")
    job = {"certify": "band_hz = [0, 40000]", "reduce2": 'name = "worse"\nmethod = "guyan"'}
    return run_job(load_job(decks.folder(folder, job, decks.deck(decks.BEAM))))


@pytest.fixture(scope="module")
def stored(done):
    return read_body(done.job.output)


def lines(axes):
    """The curves of a panel that was drawn, by name."""
    return {line.get_label(): np.array(line.get_data()) for line in axes.get_lines()}


def test_a_response_has_the_entries_that_were_asked_for(stored):
    body = stored.bodies["cb"]
    hz = np.array([100.0, 25000.0, 40000.0])
    upper, lower = body.plot_response(hz, [(1, 1), (7, 2)]).axes
    H = body.frequency_response(hz)
    np.testing.assert_array_equal(lines(upper)["motion 7 by load 2"], [hz, np.abs(H[:, 6, 1])])
    np.testing.assert_allclose(
        np.exp(1j * np.radians(lines(lower)["motion 1 by load 1"][1])), H[:, 0, 0] / np.abs(H[:, 0, 0]), atol=1e-9
    )
    # By default from below the first elastic mode to beyond the last, with all resonances in it.
    chart = response_chart(body, None, None)
    assert [curve.name for curve in chart.panels[0].curves] == [f"motion {k} by load {k}" for k in range(1, 7)]
    x = chart.panels[0].curves[0].x
    assert np.isin(body.frequencies_hz[6:], x).all() and x[0] < body.frequencies_hz[6] < 2 * body.frequencies_hz[-1]
    with refusal("value", "entries", "13", "cb", "12"):
        body.plot_response(entries=[(13, 1)])


@pytest.mark.parametrize("hz", [[], [0.0], [np.nan], [10.0, np.inf], [-1.0, 5.0], "x", [[1.0, 2.0]], [1e300]])
def test_frequencies_that_no_axis_has_are_told(stored, hz):
    with refusal("value", "frequencies_hz"):
        stored.bodies["cb"].plot_response(hz)


def test_one_frequency_and_one_above_zero_are_drawn(stored):
    body = stored.bodies["cb"]
    for hz in ([100.0], [0.0, 100.0]):
        figure = body.plot_response(hz, [(1, 1)])
        figure.canvas.draw()
        assert lines(figure.axes[0])["motion 1 by load 1"][0].tolist() == [100.0]
    with refusal("missing", "entries"):
        body.plot_response([100.0], [])


def test_an_axis_of_ratios_without_a_positive_number_is_plain(recwarn):
    curve = Curve(name="nothing", x=np.array([1.0, 2.0]), y=np.zeros(2))
    figure = Chart(title="", panels=(Panel(y_label="y", curves=(curve,)),)).figure()
    figure.canvas.draw()
    assert (figure.axes[0].get_xscale(), figure.axes[0].get_yscale()) == ("log", "linear") and not recwarn.list


def test_modes_below_a_frequency_and_their_density(stored):
    body = stored.bodies["cb"]
    upper, lower = body.plot_modal_density().axes
    own = body.frequencies_hz[6:]
    x, y = lines(upper)["cb"]
    for hz in (30000.0, 60000.0, 1e5):
        assert y[np.searchsorted(x, hz) - 1] == (own < hz).sum()
    assert "full model" in lines(upper) and (lines(upper)["full model"][0] > 0).all()
    # Density times the widths of the bands are all modes.
    x, y = lines(lower)["cb"]
    assert np.nansum(y[::2] * (x[1::2] - x[::2])) == pytest.approx(len(own))
    with refusal("missing", "modes"):
        density_chart({"none": np.zeros(0)})


def test_frequencies_that_are_no_numbers_are_left_out_of_the_density_and_counted():
    chart = density_chart({"one": np.array([10.0, 20.0, np.inf]), "two": np.array([np.nan, np.inf])}, np.array([10.0]))
    upper = chart.panels[0]
    assert [curve.name for curve in upper.curves] == ["full model", "one"] and upper.curves[1].x.max() == 20.0
    assert chart.note == "3 frequencies that are NaN or infinite are left out"
    with refusal("missing", "modes"):
        density_chart({"none": np.array([np.inf])})


def test_mac_of_a_body_with_itself_and_another(stored):
    cb, worse = stored.bodies["cb"], stored.bodies["worse"]
    [panel] = mac_chart(cb, None, 4).panels
    np.testing.assert_allclose(np.diag(panel.values), 1, atol=1e-6)
    assert panel.rows[0] == f"{cb.frequencies_hz[6]:,.2f} Hz" and panel.values.shape == (4, 4)
    [panel] = mac_chart(cb, worse, 10).panels
    a, b = (body.modes(10)[k].ravel() for body, k in ((cb, 2), (worse, 0)))
    assert panel.values[2, 0] == pytest.approx((a @ b) ** 2 / (a @ a * (b @ b)))
    assert cb.plot_mac(worse).axes[0].images[0].get_array().shape == (10, 6)
    with refusal("value", "other"):
        cb.plot_mac(3)


def test_bodies_at_other_nodes_have_no_mac(stored, tmp_path):
    other = decks.folder(tmp_path, {}, decks.deck(decks.BEAM[:8]))
    run_job(load_job(other))
    with refusal("conflict", "nodes"):
        stored.bodies["cb"].plot_mac(read_body(tmp_path / "part.h5").bodies["cb"])


def test_a_certificate_draws_its_errors_and_limits(stored):
    known = {name: body.certificate for name, body in stored.bodies.items()}
    upper, lower = known["cb"].plot().axes
    assert set(lines(upper)) == {"full model", "body"} and set(lines(lower)) == {"body", "body, limit"}
    np.testing.assert_array_equal(lines(lower)["body"], [known["cb"].frequencies_hz, known["cb"].error])
    # The limit lies above the error everywhere, also where cells are drawn as one.
    error, limit = lines(lower)["body"], lines(lower)["body, limit"]
    inside = (error[0] >= limit[0, 0]) & (error[0] <= limit[0, -1])
    at = np.searchsorted(limit[0, 1::2], error[0][inside])
    assert (limit[1, ::2][np.minimum(at, len(limit[1]) // 2 - 1)] >= error[1][inside] * (1 - 1e-9)).all()
    assert len(certificate_chart(known).panels[0].curves) == 3


def test_cost_by_stage(done):
    time, memory = done.plot_cost().axes
    assert [text.get_text() for text in time.get_yticklabels()] == [stage.name for stage in done.stages]
    assert [bar.get_width() for bar in memory.patches] == [stage.peak_memory_bytes / 1e6 for stage in done.stages]
    plain = cost_chart({"read": 1.5}, {"read": 2e6}).plain()
    assert plain["panels"][0] == {
        "kind": "bars",
        "label": "seconds",
        "names": ["read"],
        "values": [1.5],
        "texts": ["1.50 s"],
    }


def test_a_campbell_diagram_has_the_modes_at_each_speed(tmp_path):
    spin = {"spin": 'speed = [0, 2000]\naxis = [1, 0, 0]\nheld = ["left"]'}
    run_job(load_job(decks.folder(tmp_path, spin, decks.deck(decks.BEAM))))
    body = read_body(tmp_path / "part.h5").bodies["cb"]
    [panel] = body.plot_campbell([0.0, 1000.0], 4).axes
    drawn = np.concatenate([line for name, line in lines(panel).items() if name != "speed"], axis=1)
    wanted = [s.imag / (2 * np.pi) for whirl in campbell(body, [0.0, 1000.0], 4) for s in whirl.eigenvalues]
    np.testing.assert_allclose(np.sort(drawn[1]), np.sort(wanted))
    np.testing.assert_array_equal(np.unique(drawn[0]), [0, 1000])
    np.testing.assert_allclose(lines(panel)["speed"], [[0, 1000], [0, 1000 / (2 * np.pi)]])
    assert set(drawn[0]) < set(np.concatenate(list(lines(body.plot_campbell().axes[0]).values()), axis=1)[0])


def test_plain_values_have_gaps_where_there_are_no_numbers(stored):
    plain = density_chart({"cb": stored.bodies["cb"].frequencies_hz[6:]}).plain()
    density = plain["panels"][1]["curves"][0]
    assert None in density["y"] and density["color"] == 0 and len(density["x"]) == len(density["y"])
    with refusal("missing", "spin", "[spin]"):
        stored.bodies["cb"].plot_campbell()
