"""All cases of one promise in one test, which says of which case it is not kept."""

import functools
import inspect
import reprlib


def each(names, cases):
    """Call the test with every case in turn; names as ``pytest.mark.parametrize`` takes them."""
    names = [name.strip() for name in names.split(",")] if isinstance(names, str) else names
    cases = [case if len(names) > 1 else (case,) for case in cases]

    def of(test):
        signature = inspect.signature(test)
        fixtures = [item for name, item in signature.parameters.items() if name not in names]

        @functools.wraps(test)
        def run(*args, **kwargs):
            for case in cases:
                values = dict(zip(names, case, strict=True))
                try:
                    test(*args, **kwargs, **values)
                except Exception as error:
                    raise AssertionError(f"with {reprlib.repr(values)}: {error}") from error

        run.__signature__ = signature.replace(parameters=fixtures)
        return run

    return of
