"""Work that other processes share: it knows neither models nor windows."""
