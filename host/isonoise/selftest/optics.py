def optics_cases(bench):
    return ()
