"""Draws the liquid of a 2D run in ParaView, coloured by pressure, at one instant.

    xvfb-run -a pvpython tools/paraview_picture.py DIR TIME LARGEST_PRESSURE FILE.png

The picture in the README: out/dam_break_2d 0.85 2500 cases/dam_break_2d/pressure.png
"""

import sys

from paraview import simple

folder, time, largest, file = sys.argv[1], float(sys.argv[2]), float(sys.argv[3]), sys.argv[4]
source = simple.OpenDataFile(folder + "/particles.pvd")
nearest = min(source.TimestepValues, key=lambda t: abs(t - time))

view = simple.CreateView("RenderView")
view.ViewSize = [1100, 620]
view.OrientationAxesVisibility = 0
view.ViewTime = nearest

fluid = simple.Threshold(source)
fluid.Scalars = ["POINTS", "kind"]
fluid.ThresholdMethod = "Below Lower Threshold"
fluid.LowerThreshold = 0.5
shown = simple.Show(fluid, view)
shown.Representation = "Points"
shown.PointSize = 5.5
shown.RenderPointsAsSpheres = 1
simple.ColorBy(shown, ("POINTS", "pressure"))
colours = simple.GetColorTransferFunction("pressure")
colours.ApplyPreset("Turbo", True)
fluid.UpdatePipeline(nearest)
colours.RescaleTransferFunction(0, largest)

bar = simple.GetScalarBar(colours, view)
bar.Title, bar.ComponentTitle = "pressure (Pa)", ""
bar.TitleColor = bar.LabelColor = [0, 0, 0]
shown.SetScalarBarVisibility(view, True)
clock = simple.AnnotateTimeFilter(source)
clock.Format = "t = {time:.2f} s"
simple.Show(clock, view).Color = [0, 0, 0]

view.CameraPosition = [0.44, 0.24, 2]
view.CameraFocalPoint = [0.44, 0.24, 0]
view.CameraParallelProjection = 1
view.CameraParallelScale = 0.27
simple.SaveScreenshot(file, view, OverrideColorPalette="WhiteBackground")
