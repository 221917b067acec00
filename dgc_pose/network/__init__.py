"""The network of Melekhov et al. (DGC-Net, WACV 2019) and our slim dgcm-lite0."""
