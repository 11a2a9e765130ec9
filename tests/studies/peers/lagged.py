"""Ridge regression of the residual of the identified model on lagged columns: a prediction without terms, for scale.

The columns are voltage, its rate, the force of the identified model and further recorded columns. Each is used at the
present and at lags of up to ten seconds; the first three also squared. The penalty is chosen on the last fifth of the
recordings.
"""

import math

import exchange
import numpy as np
from sklearn.linear_model import Ridge
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

LAGS_s = (0.0, 0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0)
PENALTIES = tuple(float(10.0**power) for power in range(-3, 7))


def main() -> None:
    """Fit every penalty, take the best, predict."""
    given = exchange.read()
    tables = [_features(record) for record in given.recordings]
    missing_N = [record.missing_N for record in given.recordings]
    splits = [record.split for record in given.recordings]
    trained = np.vstack([table[:split] for table, split in zip(tables, splits, strict=True)])
    judged = np.vstack([table[split:] for table, split in zip(tables, splits, strict=True)])
    target_N = np.concatenate([values[:split] for values, split in zip(missing_N, splits, strict=True)])
    left_N = np.concatenate([values[split:] for values, split in zip(missing_N, splits, strict=True)])
    best, best_error, setting = None, math.inf, ""
    for penalty in PENALTIES:
        model = make_pipeline(StandardScaler(), Ridge(alpha=penalty)).fit(trained, target_N)
        error = float(np.mean((left_N - model.predict(judged)) ** 2))
        if error < best_error:
            best, best_error, setting = model, error, f"penalty {penalty:g}"
    assert best is not None
    force_N = given.held_out["base_N"] + best.predict(_features(given.held_out))
    exchange.answer(given, force_N, [f"{trained.shape[1]} columns"], setting, len(PENALTIES))


def _features(record: exchange.Record) -> np.ndarray:
    """Columns, shape (n, features); before its beginning a record rested as it begins."""
    time_s = record["time_s"]
    rate = np.gradient(record["voltage_V"], time_s)
    driven = [record["voltage_V"], record["base_N"], rate]
    columns = [*driven, *(record[name] for name in record.extra)]
    lagged = [np.interp(time_s - lag_s, time_s, values) for values in columns for lag_s in LAGS_s]
    return np.column_stack([*lagged, *(values * values for values in driven), np.abs(rate)])


if __name__ == "__main__":
    main()
