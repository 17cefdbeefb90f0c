"""Opens a run's particles in ParaView, checks what a user would see, and takes a picture on demand.

    pvpython tools/paraview_check.py DIR [--counts N N ...]
    xvfb-run -a pvpython tools/paraview_check.py DIR --png FILE

Checks: the time axis is the one of particles.pvd in seconds; every snapshot has all its points, each a
vertex (so that no filter is needed to see it), an id of its own, and a value of every field. With
--counts, the snapshots must have these numbers of particles. With --png, the last snapshot is drawn,
coloured by pressure, and must show something; this needs a display (ParaView from Debian does not draw
without one; xvfb-run gives one). Exit code 1 and a sentence otherwise.
"""

import argparse
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path

from paraview import servermanager, simple
from vtkmodules.util.numpy_support import vtk_to_numpy


def check(condition, sentence):
    """Ends the program with the sentence unless the condition holds."""
    if not condition:
        sys.exit(f"paraview_check: {sentence}")


def snapshot(source, time):
    """The poly data of one time, as ParaView reads it."""
    source.UpdatePipeline(time)
    data = servermanager.Fetch(source)
    # A collection reads as a multi-block of one part.
    while data.IsA("vtkMultiBlockDataSet"):
        data = data.GetBlock(0)
    return data


def picture(source, file):
    """Writes a picture coloured by pressure, and returns the number of coloured pixels."""
    view = simple.CreateView("RenderView")
    view.ViewSize = [1200, 900]
    view.OrientationAxesVisibility = 0
    shown = simple.Show(source, view)
    shown.PointSize = 4
    simple.ColorBy(shown, ("POINTS", "pressure"))
    shown.RescaleTransferFunctionToDataRange(True)
    shown.SetScalarBarVisibility(view, True)
    simple.ResetCamera(view)
    simple.SaveScreenshot(str(file), view, OverrideColorPalette="WhiteBackground")
    # Without the colour bar, everything that is not background is a particle.
    shown.SetScalarBarVisibility(view, False)
    view.UseColorPaletteForBackground = 0
    view.Background = [1, 1, 1]
    simple.Render(view)
    pixels = vtk_to_numpy(view.CaptureWindow(1).GetPointData().GetScalars())
    return int((pixels[:, :3] != 255).any(axis=1).sum())


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, help="folder of a run")
    parser.add_argument("--png", type=Path, help="picture to write")
    parser.add_argument("--counts", type=int, nargs="+", help="expected number of particles a snapshot")
    options = parser.parse_args()

    collection = options.folder / "particles.pvd"
    times = [float(entry.get("timestep")) for entry in ElementTree.parse(collection).iter("DataSet")]
    check(times, f"{collection} names no snapshot")
    source = simple.PVDReader(FileName=str(collection))
    source.UpdatePipelineInformation()
    # A single time comes back as a number.
    shown = source.TimestepValues if hasattr(source.TimestepValues, "__len__") else [source.TimestepValues]
    check(list(shown) == times, f"ParaView shows the times {list(shown)}, the collection has {times}")

    counts = []
    for time in times:
        data = snapshot(source, time)
        count = data.GetNumberOfPoints()
        counts.append(count)
        check(data.GetNumberOfVerts() == count, f"t = {time} s: {data.GetNumberOfVerts()} vertices of {count}")
        fields = data.GetPointData()
        for index in range(fields.GetNumberOfArrays()):
            array = fields.GetArray(index)
            size = array.GetNumberOfTuples()
            check(size == count, f"t = {time} s: {array.GetName()} has {size} of {count} values")
        for name in ("velocity", "pressure", "id"):
            check(count == 0 or fields.GetArray(name), f"t = {time} s: no {name}")
        if count:
            distinct = len(set(vtk_to_numpy(fields.GetArray("id"))))
            check(distinct == count, f"t = {time} s: {distinct} different ids of {count}")
    check(not options.counts or counts == options.counts, f"particles: {counts}, not {options.counts}")

    if options.png:
        simple.GetAnimationScene().AnimationTime = times[-1]
        pixels = picture(source, options.png)
        check(counts[-1] == 0 or pixels > 0, "the particles cannot be seen without a filter")
    print(f"{len(times)} snapshots, {times[0]} to {times[-1]} s, {counts[-1]} particles in the last")


main()
