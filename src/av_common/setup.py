from av_common.packaging import set_up

set_up()
