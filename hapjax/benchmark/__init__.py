"""Measurements of hapjax on the machine at hand, each a module with `measure` and `report`."""
