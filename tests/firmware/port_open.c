/* No controller: drives with `reference` at `share` Hz; gives back the sample and its phase in place of Wd
 * and Wq. */
#include "port.h"

int port_init(void)
{
    return 0;
}

void port_sample(double sample, uint32_t phase, port_response *found)
{
    *found = (port_response){sample, phase, 0, 0};
}

port_output port_step(const port_input *in)
{
    return (port_output){in->reference, in->share, 0, 0};
}
