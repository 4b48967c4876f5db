import java.lang.management.ManagementFactory;
import java.util.Arrays;
import org.hipparchus.geometry.euclidean.threed.Rotation;
import org.hipparchus.geometry.euclidean.threed.Vector3D;
import org.orekit.attitudes.Attitude;
import org.orekit.attitudes.Inertia;
import org.orekit.attitudes.InertiaAxis;
import org.orekit.attitudes.TorqueFree;
import org.orekit.frames.Frame;
import org.orekit.time.AbsoluteDate;

/** Prints the nanoseconds of a state of Orekit's TorqueFree in Java itself, given the number of craft and of the states of each. */
public class TorqueFreeStates {
    static final int ROUNDS = 9;

    static double round(int craft, int states) {
        AbsoluteDate t0 = AbsoluteDate.ARBITRARY_EPOCH;
        Frame space = Frame.getRoot();
        Inertia inertia = new Inertia(new InertiaAxis(80.0, Vector3D.PLUS_I), new InertiaAxis(100.0, Vector3D.PLUS_J),
                                      new InertiaAxis(120.0, Vector3D.PLUS_K));
        double sum = 0.0;
        for (int i = 0; i < craft; i++) {
            Vector3D spin = new Vector3D(1e-3, -0.01, 0.03 * (1.0 + 1e-4 * i));
            Attitude start = new Attitude(t0, space, new Rotation(0.8, 0.36, -0.48, 0.0, false), spin, Vector3D.ZERO);
            TorqueFree law = new TorqueFree(start, inertia);
            for (int k = 0; k < states; k++) {
                sum += law.getAttitude(null, t0.shiftedBy(6000.0 * k / states), space).getRotation().getQ0();
            }
        }
        return sum;
    }

    public static void main(String[] given) {
        int craft = Integer.parseInt(given[0]), states = Integer.parseInt(given[1]);
        double[] times = new double[ROUNDS];
        double sum = 0.0;
        for (int i = 0; i < ROUNDS; i++) {
            long began = ManagementFactory.getThreadMXBean().getCurrentThreadCpuTime();
            sum += round(craft, states);
            times[i] = (ManagementFactory.getThreadMXBean().getCurrentThreadCpuTime() - began) / ((double) craft * states);
        }
        double[] warm = Arrays.copyOfRange(times, ROUNDS / 2, ROUNDS);  // compiled by then
        Arrays.sort(warm);
        System.out.println(warm[warm.length / 2] + " " + sum);
    }
}
