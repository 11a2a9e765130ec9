"""Information of the identification recordings about the base of an identified model."""

from collections.abc import Sequence

from piezod.diagnose.hypothesis.fit import fit
from piezod.diagnose.hypothesis.sampling import coarse
from piezod.diagnose.prepare import chain_of
from piezod.diagnose.verdict.information import information_of
from piezod.estimation.recordings.preparation import prepared
from piezod.estimation.recordings.sources import Source
from piezod.model import Model
from piezod.model.information import Information

FINE_STEPS = 4  # Gauss-Newton steps from the coarse fit to all compared samples


def identified_information(model: Model, sources: Sequence[Source]) -> Information | None:
    """Information about the base; at most 25,000 samples of a recording are compared. None: as in `information_of`.

    Raises
    ------
    RecordingError
        A recording is too short to be diagnosed.
    """
    chain, start = chain_of(prepared(sources, model), model)
    rough = fit(coarse(chain), (), start)
    fitted = fit(chain, (), rough.point, most_steps=FINE_STEPS)
    return information_of(chain, fitted, model, [source.sha256 for source in sources])
