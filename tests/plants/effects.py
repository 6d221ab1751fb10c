IN_PLANT = ()
def hide(bench, names, seed):
    return bench, {}
