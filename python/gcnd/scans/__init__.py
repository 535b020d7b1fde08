"""Simulated scans of clean meshes: depth cameras, fused frames, scanned prints. See docs/scans.md."""

from gcnd.scans.frame import ScanPair
from gcnd.scans.fusion import Fusion
from gcnd.scans.kinect1 import Kinect1
from gcnd.scans.kinect2 import Kinect2
from gcnd.scans.printed import Print
from gcnd.scans.simulate import SCAN_KINDS, ScanKind, simulate

__all__ = ["SCAN_KINDS", "Fusion", "Kinect1", "Kinect2", "Print", "ScanKind", "ScanPair", "simulate"]
